"""The flight's newest state as Prometheus metrics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, StateSetMetricFamily
from prometheus_client.registry import Collector

from follower.flight.supervision.supervisor import SupervisorState
from follower.ui.cockpit.hub import Hub
from follower_vision.trackers.track import TrackState

_NUMBERS = (
    ("time_s", "flight_time_seconds", "Since the flight's start", 1.0),
    ("azimuth_deg", "azimuth_error_degrees", "Target right of the nose", 1.0),
    ("elevation_deg", "elevation_error_degrees", "Target above where it is wanted", 1.0),
    ("range_m", "range_meters", "Distance to the target as the servo believes it", 1.0),
    ("height_m", "height_meters", "Height above home", 1.0),
    ("confidence", "track_confidence_ratio", "Confidence of the track", 1.0),
    ("frame_rate_hz", "frame_rate_hertz", "Frames answered for in the last second", 1.0),
    ("vision_ms", "vision_seconds", "Vision's work on the newest frame", 1e-3),
    ("control_ms", "control_seconds", "The control step's own work", 1e-3),
)
"""Key of the state, name, meaning, factor to the metric's unit."""
_FLAGS = {"armed": "Motors may turn", "consent": "The second consent stands"}
_AXES = ("forward", "right", "down")
_MOTIONS = {"asked": "by the servo", "allowed": "by the envelope", "flown": "by telemetry"}


class FlightMetrics(Collector):
    """Makes metrics of what a hub knows when they are asked for.

    What the flight does not know is left out, and so is everything before its first state.
    """

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._registry = CollectorRegistry()
        self._registry.register(self)

    def text(self) -> bytes:
        """Return the metrics in Prometheus' text format."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[GaugeMetricFamily | StateSetMetricFamily]:
        """Give each metric; see `prometheus_client`."""
        state = self._hub.state
        yield _gauge("cockpit_clients", "Open pages", float(self._hub.clients))
        if not state:
            return
        age_s = self._hub.state_age_s
        yield _gauge("state_age_seconds", "Since the flight's time moved", age_s)
        yield _states("supervisor_state", "The supervisor's state", SupervisorState, state["state"])
        yield _states("track_state", "Vision's state of the target", TrackState, state.get("track"))
        for key, name, meaning, factor in _NUMBERS:
            if state.get(key) is not None:
                yield _gauge(name, meaning, factor * state[key])
        for name, meaning in _FLAGS.items():
            yield _gauge(name, meaning, float(state.get(name, False)))
        yield _gauge("limits", "Limits that the envelope applied", len(state.get("limits", ())))
        yield from _velocities(state)


def _gauge(name: str, meaning: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"follower_{name}", meaning, value)


def _states(
    name: str, meaning: str, kinds: Iterable[str], present: str | None
) -> StateSetMetricFamily:
    values = {str(kind): kind == present for kind in kinds}
    return StateSetMetricFamily(f"follower_{name}", meaning, values)


def _velocities(state: dict[str, Any]) -> Iterator[GaugeMetricFamily]:
    said = ", ".join(f"{motion} {by}" for motion, by in _MOTIONS.items())
    name, labels = "follower_velocity_meters_per_second", ["motion", "axis"]
    velocity = GaugeMetricFamily(name, f"Heading frame: {said}", labels=labels)
    turn = GaugeMetricFamily("follower_yaw_rate_degrees_per_second", said, labels=["motion"])
    for motion in _MOTIONS:
        values = state.get(motion)
        if values is not None:
            for axis, value in zip(_AXES, values, strict=False):
                velocity.add_metric([motion, axis], value)
            turn.add_metric([motion], values[3])
    yield velocity
    yield turn
