"""A vehicle that an autopilot outside flies: what the simulated camera sees follows telemetry."""

from __future__ import annotations

from follower.links.link import Link
from follower_control.attitude_history import turned_on
from follower_control.vehicle import VehicleState
from follower_sim.kinematics import BodyState

_LONGEST_PREDICTION_S = 0.2


class TelemetryVehicle:
    """Gives the camera and the score the place that telemetry reports.

    For PX4 or ArduPilot in software-in-the-loop: their simulator flies, our world is seen. The
    autopilot's local origin is the scenario's; its ground is at height 0.

    Args:
        link: hears the autopilot; polled by the control loop.
        parked: where the vehicle stands until it is heard.
    """

    def __init__(self, link: Link, parked: BodyState) -> None:
        self._link = link
        self._parked = parked

    @property
    def state(self) -> BodyState:
        """The newest that telemetry said."""
        return self._of(self._link.state, self._parked.time_s)

    def state_at(self, time_s: float) -> BodyState:
        """Return the newest that telemetry said, carried on to `time_s` for a moment."""
        return self._of(self._link.state, time_s)

    def _of(self, vehicle: VehicleState, time_s: float) -> BodyState:
        position, attitude = vehicle.position, vehicle.attitude
        if position is None or attitude is None:
            return self._parked
        moved_s = _bounded(time_s - position.time_s)
        turned = turned_on(attitude, _bounded(time_s - attitude.time_s))
        velocity = position.north_m_s, position.east_m_s, position.down_m_s
        return BodyState(
            time_s,
            (
                position.north_m + moved_s * velocity[0],
                position.east_m + moved_s * velocity[1],
                position.down_m + moved_s * velocity[2],
            ),
            velocity,
            (turned.roll_rad, turned.pitch_rad, turned.yaw_rad),
            (attitude.roll_rate_rad_s, attitude.pitch_rate_rad_s, attitude.yaw_rate_rad_s),
        )


def _bounded(interval_s: float) -> float:
    return min(max(interval_s, -_LONGEST_PREDICTION_S), _LONGEST_PREDICTION_S)
