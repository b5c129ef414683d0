"""The truth about moving bodies, at one instant and over time; for simulator and score alone."""

import threading
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.geometry.line_of_sight import rotation, wrap_angle

Triple = tuple[float, float, float]

_KEPT_STATES = 400


@dataclass(frozen=True, slots=True)
class BodyState:
    """Pose and motion in the world (north, east, down; metres, radians, seconds).

    Attributes:
        time_s: when this is true, on the simulation's clock.
        position_m: (north, east, down); the ground is the plane down = 0.
        velocity_m_s: (north, east, down).
        attitude_rad: (roll, pitch, yaw), aerospace order, body forward-right-down.
        rates_rad_s: body rates about (forward, right, down).
    """

    time_s: float
    position_m: Triple
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    attitude_rad: Triple = (0.0, 0.0, 0.0)
    rates_rad_s: Triple = (0.0, 0.0, 0.0)

    @property
    def yaw_rad(self) -> float:
        """Heading from north, rad, clockwise seen from above."""
        return self.attitude_rad[2]

    @property
    def body_to_world(self) -> npt.NDArray[np.float64]:
        """3x3 matrix: body vectors to world vectors."""
        return rotation(*self.attitude_rad)


class StateHistory:
    """Newest states, oldest first, with a look-up between them.

    A camera's thread may look while the autopilot's adds.
    """

    def __init__(self, first: BodyState) -> None:
        self._states: deque[BodyState] = deque([first], maxlen=_KEPT_STATES)
        self._lock = threading.Lock()

    @property
    def newest(self) -> BodyState:
        """The last state added."""
        return self._states[-1]

    def add(self, state: BodyState) -> None:
        """Append a state later than all others; the oldest is forgotten."""
        with self._lock:
            self._states.append(state)

    def at(self, time_s: float) -> BodyState:
        """Return the state at a time, seconds, interpolated; outside what is kept, the nearest."""
        with self._lock:
            states = self._states
            if time_s >= states[-1].time_s:
                return states[-1]
            after = bisect_right(states, time_s, key=lambda state: state.time_s)
            a, b = states[max(after - 1, 0)], states[min(after, len(states) - 1)]
        return a if a is b else _between(a, b, time_s)


def _between(a: BodyState, b: BodyState, time_s: float) -> BodyState:
    share = (time_s - a.time_s) / (b.time_s - a.time_s)
    return BodyState(
        time_s,
        mix(a.position_m, b.position_m, share),
        mix(a.velocity_m_s, b.velocity_m_s, share),
        _mix_angles(a.attitude_rad, b.attitude_rad, share),
        mix(a.rates_rad_s, b.rates_rad_s, share),
    )


def mix(a: Triple, b: Triple, share: float) -> Triple:
    """Return what lies a share of the way from one vector to another, in their unit."""
    (x, y, z), (to_x, to_y, to_z) = a, b
    return x + (to_x - x) * share, y + (to_y - y) * share, z + (to_z - z) * share


def _mix_angles(a: Triple, b: Triple, share: float) -> Triple:
    x, y, z = (wrap_angle(p + wrap_angle(q - p) * share) for p, q in zip(a, b, strict=True))
    return x, y, z


@dataclass(frozen=True, slots=True)
class TruthSample:
    """The truth at one instant, taken beside every control step.

    Attributes:
        time_s: on the system's clock.
        vehicle: where the vehicle really is and how it moves.
        target_position_m: (north, east, down) of the target's centre.
        target_velocity_m_s: (north, east, down).
        in_frame_share: share of the target's true box that lies inside the image, 0 to 1.
        visible_share: share of the target that nothing hides, 0 to 1.
        range_m: distance from the camera to the target's centre.
        azimuth_rad: of the target from the vehicle's heading, positive to the right.
        elevation_rad: of the target from the horizontal, positive up.
    """

    time_s: float
    vehicle: BodyState
    target_position_m: Triple
    target_velocity_m_s: Triple
    in_frame_share: float
    visible_share: float
    range_m: float
    azimuth_rad: float
    elevation_rad: float
