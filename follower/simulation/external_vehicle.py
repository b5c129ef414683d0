"""A vehicle flown by an external autopilot: the simulated camera follows its telemetry."""

import math
from dataclasses import dataclass
from typing import Self, TypeAlias

from follower.links.link import Link
from follower_control.vehicle.history import turned_on
from follower_control.vehicle.state import Attitude, LocalPosition
from follower_sim.kinematics import BodyState, Triple
from follower_vision.geometry.line_of_sight import wrap_angle

_LONGEST_PREDICTION_S = 0.2
_KEPT = 200
_Report: TypeAlias = tuple[LocalPosition, Attitude]


class TelemetryVehicle:
    """Gives the camera and the score the place that telemetry reports, in the scenario's world.

    For PX4 or ArduPilot in software-in-the-loop: their simulator flies, our world is seen. Their
    world begins elsewhere and with another heading than the scenario: one rigid motion, a turn
    about the vertical and a shift, takes the vehicle's place and heading at `place` to where the
    scenario has it start. Until then it stands there, at the height that it has. The follower's
    control knows nothing of that: it flies in the autopilot's own world. Height 0 is the ground
    in both.

    Args:
        link: to the autopilot; polled by the control loop.
        parked: where the vehicle is to stand at `place`, and before it reports.
    """

    def __init__(self, link: Link, parked: BodyState) -> None:
        self._link = link
        self._parked = parked
        self._motion: _RigidMotion | None = None
        self._reports: tuple[_Report, ...] = ()

    @property
    def state(self) -> BodyState:
        """The newest state by telemetry, in the scenario's world: metres, m/s, radians, NED."""
        newest = self._link.state.attitude
        return self.state_at(self._parked.time_s if newest is None else newest.time_s)

    def state_at(self, time_s: float) -> BodyState:
        """Return the newest state that was told before `time_s`, predicted to it, at most 0.2 s on.

        What was told is kept for some seconds: a picture is looked at after it was taken.
        """
        position, attitude = self._link.state.position, self._link.state.attitude
        if position is None or attitude is None:
            return self._parked
        if self._reports[-1:] != ((position, attitude),):
            self._reports = *self._reports[-_KEPT:], (position, attitude)
        position, attitude = next(
            (one for one in reversed(self._reports) if one[1].time_s <= time_s), self._reports[0]
        )
        motion = self._motion or _RigidMotion.onto(self._parked, position, attitude)
        moved_s = _bounded(time_s - position.time_s)
        turned = turned_on(attitude, _bounded(time_s - attitude.time_s))
        velocity = position.north_m_s, position.east_m_s, position.down_m_s
        place = (
            position.north_m + moved_s * velocity[0],
            position.east_m + moved_s * velocity[1],
            position.down_m + moved_s * velocity[2],
        )
        return BodyState(
            time_s,
            motion.place(place),
            motion.turned(velocity),
            (turned.roll_rad, turned.pitch_rad, wrap_angle(turned.yaw_rad + motion.turn_rad)),
            (attitude.roll_rate_rad_s, attitude.pitch_rate_rad_s, attitude.yaw_rate_rad_s),
        )

    def place(self) -> None:
        """From now on let it move: the scenario's start is where it is now."""
        position, attitude = self._link.state.position, self._link.state.attitude
        if position is not None and attitude is not None:
            self._motion = _RigidMotion.onto(self._parked, position, attitude)


@dataclass(frozen=True, slots=True)
class _RigidMotion:
    """From the autopilot's world to the scenario's: a turn about a place, which is then shifted.

    Attributes:
        turn_rad: clockwise seen from above.
        from_m, to_m: (north, east) of a place in both worlds.
    """

    turn_rad: float
    from_m: tuple[float, float]
    to_m: tuple[float, float]

    @classmethod
    def onto(cls, parked: BodyState, position: LocalPosition, attitude: Attitude) -> Self:
        """Return the one that takes a vehicle's place and heading to the parked one's."""
        here = position.north_m, position.east_m
        turn_rad = wrap_angle(parked.yaw_rad - attitude.yaw_rad)
        return cls(turn_rad, here, (parked.position_m[0], parked.position_m[1]))

    def place(self, place_m: Triple) -> Triple:
        """Return where a place of the autopilot's world lies."""
        away_m = place_m[0] - self.from_m[0], place_m[1] - self.from_m[1], place_m[2]
        north, east, down = self.turned(away_m)
        return self.to_m[0] + north, self.to_m[1] + east, down

    def turned(self, vector: Triple) -> Triple:
        """Return a vector of the autopilot's world."""
        north, east, down = vector
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return c * north - s * east, s * north + c * east, down


def _bounded(interval_s: float) -> float:
    return min(max(interval_s, -_LONGEST_PREDICTION_S), _LONGEST_PREDICTION_S)
