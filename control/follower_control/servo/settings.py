"""What is wanted of a pursuit, and the gains."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache, partial
from typing import Annotated

from pydantic import BeforeValidator

from follower_control.common.strict_config import check_ranges
from follower_control.servo.pid import PidSettings
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_vision.plugins import Plugin, PluginError, PluginGroup, PluginGuard

_TINY = 1e-6
"""A share of the largest value: of what is smaller, logarithm and inverse are no numbers."""


MODE_PLUGINS = PluginGroup("follower.follow_modes", "follow mode")
"""Each returns a setpoint when it is called with a `VisualServo` and a `ServoStep`."""


class FollowMode(StrEnum):
    """What the servo does about the target; another package's mode is a member, but not listed."""

    CHASE = "chase"
    """Turn towards it, go up or down with it, and keep its distance."""
    WATCH = "watch"
    """Only turn towards it."""
    SIDE = "side"
    """Like `chase`, and stay on one side of its course."""
    ORBIT = "orbit"
    """Like `chase`, and go round it."""
    OVERHEAD = "overhead"
    """Stay above it, with a camera that looks down."""

    @classmethod
    def _missing_(cls, value: object) -> "FollowMode | None":
        added = isinstance(value, str) and MODE_PLUGINS.find(value) is not None
        return added_mode(str(value)).mode if added else None


@dataclass(frozen=True, slots=True)
class AddedMode:
    """A follow mode of another package.

    Attributes:
        mode: its name.
        law: returns a setpoint for a `VisualServo` and a `ServoStep`, or fails.
        plugin: where it is from.
    """

    mode: FollowMode
    law: Callable[..., VelocitySetpoint]
    plugin: Plugin

    def guarded(self) -> Callable[..., VelocitySetpoint]:
        """Return the law for one flight: where it fails it holds, which is told once."""
        guard = PluginGuard(self.plugin, "the vehicle holds")

        def law(*step: object) -> VelocitySetpoint:
            return guard.run(partial(self.law, *step), HOLD, _is_setpoint)

        return law


@cache  # modes are compared by identity, and a change in flight must not wait for an import
def added_mode(name: str) -> AddedMode:
    """Return the mode that another package adds.

    Raises:
        PluginError: none does, or it cannot be used.
    """
    plugin = MODE_PLUGINS.find(name)
    if plugin is None:
        there = ", ".join([*FollowMode, *MODE_PLUGINS.names(tuple(FollowMode))])
        raise PluginError(f"there is no follow mode {name!r}; there are {there}")
    law = plugin.load()
    mode = str.__new__(FollowMode, name)
    mode._name_ = mode._value_ = name
    return AddedMode(mode, law, plugin)


def _follow_mode(value: object) -> FollowMode:
    """Return the mode of a name; pydantic passes on what a validator raises, not what enums do."""
    ours = next((mode for mode in FollowMode if mode == value), None)
    return ours or added_mode(str(value)).mode


def _is_setpoint(answer: VelocitySetpoint) -> bool:
    return isinstance(answer, VelocitySetpoint) and answer.is_finite


class RangeFrom(StrEnum):
    """What the distance to the target is taken from."""

    SIZE = "size"
    """Its size in the image."""
    GROUND = "ground"
    """Where the line of sight meets level ground, if telemetry has our height; else its size.
    For a target that stands on the ground and has another size from other sides."""


class OverheadYaw(StrEnum):
    """What the nose does while the vehicle stays above the target."""

    FREE = "free"
    """It stays as it is."""
    COURSE = "course"
    """It turns to the target's course."""


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """What is wanted of the pursuit, and the gains.

    The loops' outputs are, per radian of error: yaw rate for azimuth, vertical velocity over range
    for elevation; and per unit of log scale: forward velocity over `distance_m` for range.

    Attributes:
        mode: which way to follow.
        distance_m: wanted distance to the target.
        target_size_m: the square root of the target's width times its height as seen. None holds
            the size that the target has in the image at the start; `distance_m` then says about
            how far that is, and scales the gains.
        range_from: what the distance is taken from.
        target_middle_m: with `range_from: ground`: how high the target's middle is above ground.
        elevation_deg: at which elevation to keep the target; None: at the image's centre.
        hold_height: never go up or down.
        centred_deg: up to this azimuth error the forward speed is as the range loop wants it.
        off_axis_deg: from this azimuth error on there is none.
        max_forward_m_s: largest forward velocity.
        max_backward_m_s: largest backward velocity.
        max_vertical_m_s: largest velocity up or down.
        max_yaw_rate_deg_s: largest yaw rate.
        target_acceleration_m_s2: how hard the target is expected to manoeuvre: the root of the
            spectral density of its acceleration, per sqrt(Hz). More follows its changes of speed
            sooner, and errors of its size as well.
        target_acceleration_across_m_s2: the same across the line of sight, where a distance by size
            errs little; None: as along it.
        size_error_share: by what share of itself the target's size is usually wrong for seconds
            together, as a tracker's box of a small target is (0.08 measured). Such errors are then
            not taken for the target's motion along the line of sight, nor, for as long, are true
            changes of its speed; 0 takes all errors for new in each frame.
        sink_share: what share of the fastest sinking a target below may be closed in on with: no
            faster than the vehicle can sink with it, so that it does not leave the image below; the
            rest is for a target that brakes. What a target that is seen too low needs of it comes
            first. 0 closes in however fast the range loop wants.
        schedule_range: scale the range loop's gains with the distance that is wanted now, when a
            stick offset brings the vehicle nearer or farther than `distance_m`: the loop stays as
            fast and as robust as it is at `distance_m`. Without it, a quarter of the distance makes
            the gain four times as high, and the margins thin.
        side_deg: for `side`: where to stay, from the target's course, clockwise seen from above:
            0 is ahead of it, 90 on its right, 180 behind it.
        orbit_m_s: for `orbit`: speed round the target; positive is clockwise seen from above.
        orbit_deg_s: for `orbit`: rate instead of speed; None takes the speed.
        max_sideways_m_s: largest velocity across the line of sight, beside the target's own.
        overhead_yaw: for `overhead`: what the nose does.
        course_filter_s: time constant of the target's velocity, for its course.
        azimuth: loop from azimuth error to yaw rate.
        elevation: loop from elevation error to vertical velocity over range.
        range: loop from the logarithm of range over wanted range to forward velocity.
        bearing: for `side`: loop from bearing error to the rate of going round.
        orbit_rate: for `orbit`: loop from the error of the rate of going round to that rate.
        overhead: for `overhead`: loop from the angle off the vertical to horizontal velocity over
            height above the target.
    """

    mode: Annotated[FollowMode, BeforeValidator(_follow_mode)] = FollowMode.CHASE
    distance_m: float = 15.0
    target_size_m: float | None = None
    range_from: RangeFrom = RangeFrom.SIZE
    target_middle_m: float = 0.0
    elevation_deg: float | None = None
    hold_height: bool = False
    centred_deg: float = 10.0
    off_axis_deg: float = 35.0
    max_forward_m_s: float = 10.0
    max_backward_m_s: float = 3.0
    max_vertical_m_s: float = 2.0
    max_yaw_rate_deg_s: float = 60.0
    target_acceleration_m_s2: float = 1.5
    target_acceleration_across_m_s2: float | None = None
    size_error_share: float = 0.0
    sink_share: float = 0.0
    schedule_range: bool = True
    side_deg: float = 90.0
    orbit_m_s: float = 3.0
    orbit_deg_s: float | None = None
    max_sideways_m_s: float = 5.0
    overhead_yaw: OverheadYaw = OverheadYaw.FREE
    course_filter_s: float = 1.0
    azimuth: PidSettings = field(default_factory=lambda: PidSettings(kp=1.5))
    elevation: PidSettings = field(default_factory=lambda: PidSettings(kp=0.8, ki=0.1))
    range: PidSettings = field(
        default_factory=lambda: PidSettings(kp=0.5, ki=0.05, kd=0.3, cut_tolerance=0.03)
    )
    bearing: PidSettings = field(
        default_factory=lambda: PidSettings(kp=0.4, ki=0.02, cut_tolerance=0.03)
    )
    orbit_rate: PidSettings = field(
        default_factory=lambda: PidSettings(kp=0.0, ki=0.3, cut_tolerance=0.03)
    )
    overhead: PidSettings = field(
        default_factory=lambda: PidSettings(kp=0.6, ki=0.06, kd=0.2, cut_tolerance=0.03)
    )

    def __post_init__(self) -> None:
        check_ranges(
            self,
            distance_m=(500 * _TINY, 500),
            target_size_m=(200 * _TINY, 200),
            max_forward_m_s=(50 * _TINY, 50),
            max_backward_m_s=(50 * _TINY, 50),
            max_vertical_m_s=(50 * _TINY, 50),
            max_sideways_m_s=(50 * _TINY, 50),
            max_yaw_rate_deg_s=(720 * _TINY, 720),
            target_acceleration_m_s2=(50 * _TINY, 50),
            target_acceleration_across_m_s2=(50 * _TINY, 50),
            target_middle_m=(0, 500),
            elevation_deg=(-90, 90),
            side_deg=(-360, 360),
            orbit_m_s=(-self.max_sideways_m_s, self.max_sideways_m_s),
            orbit_deg_s=(-90, 90),
            course_filter_s=(0, 3600),
            size_error_share=(0, 0.5),
            sink_share=(0, 1),
        )
        if not 0 <= self.centred_deg < self.off_axis_deg <= 180:
            raise ValueError("0 <= centred_deg < off_axis_deg <= 180 does not hold")
