"""Velocity across the line of sight: staying on one side of the target, or going round it."""

import cmath
import math

from follower_control.common.small_matrix import clip
from follower_control.servo.pid import Pid
from follower_control.servo.settings import FollowMode, OverheadYaw, ServoSettings
from follower_control.target.world_filter import TargetMotion
from follower_vision.geometry.line_of_sight import wrap_angle


class LateralControl:
    """The part of `side` and `orbit` that chasing has not.

    The bearing is that of the vehicle as seen from the target, from north and clockwise. The
    target's own velocity across the line of sight is fed forward.
    """

    def __init__(self, settings: ServoSettings) -> None:
        self._settings = settings
        self._bearing_pid, self._rate_pid = Pid(settings.bearing), Pid(settings.orbit_rate)
        self.start(FollowMode.CHASE)

    def change(self, settings: ServoSettings) -> None:
        """Go on by other settings; the loops go on where they were."""
        turned = math.radians(settings.side_deg - self._settings.side_deg)
        self._settings = settings
        self._side_rad += turned
        self._bearing_pid.change(settings.bearing)
        self._rate_pid.change(settings.orbit_rate)

    def start(self, mode: FollowMode, right_m_s: float = 0.0) -> None:
        """Begin at the present velocity to the right, m/s; the side is that of the settings."""
        self._mode = mode
        self._side_rad = math.radians(self._settings.side_deg)
        self._present: float | None = right_m_s
        self._step = 0.0
        self._asked, self._excess = right_m_s, 0.0
        self._bearing_pid.start()
        self._rate_pid.start()

    def update(
        self,
        offset: complex,
        offset_rate: complex,
        target: TargetMotion,
        offset_m_s: float,
        allowed_m_s: float,
        interval_s: float,
    ) -> float:
        """Return the velocity to the right of the line of sight, m/s.

        Args:
            offset: horizontal vector to the target; north + 1j * east.
            offset_rate: its rate, m/s.
            target: how it moves.
            offset_m_s: added; `side` moves its side by it.
            allowed_m_s: what the envelope allowed of the last answer.
            interval_s: since the last update.
        """
        reach = max(abs(offset), 1.0)
        azimuth = cmath.phase(offset)
        saturation = self._excess - (self._asked - allowed_m_s) / reach
        if self._mode is FollowMode.ORBIT:
            turning = (offset_rate * cmath.rect(1.0, -azimuth)).imag / reach
            round_rad_s = self._orbit(turning, reach, saturation, interval_s)
        else:
            round_rad_s = self._stay(azimuth, target, offset_m_s / reach, saturation, interval_s)
        round_m_s = clip(round_rad_s * reach, self._settings.max_sideways_m_s)
        self._excess = round_rad_s - round_m_s / reach
        # Going to the right takes us round the target against the clock.
        across_m_s = (target.velocity_m_s * cmath.rect(1.0, -azimuth)).imag
        wanted = across_m_s - round_m_s + offset_m_s
        self._asked = self._faded(wanted, interval_s)
        return self._asked

    def _stay(
        self,
        azimuth: float,
        target: TargetMotion,
        offset: float,
        saturation: float,
        interval_s: float,
    ) -> float:
        """Return the rate of going round the target, positive is clockwise from above."""
        if target.course_rad is None:
            return 0.0
        self._side_rad -= offset * interval_s
        error = wrap_angle(target.course_rad + self._side_rad - azimuth - math.pi)
        return self._bearing_pid.update(error, -error, interval_s, saturation=saturation)

    def _orbit(self, turning: float, reach: float, saturation: float, interval_s: float) -> float:
        """Return the rate likewise; an autopilot that flies too slowly is asked for more."""
        wanted = self._orbit_rate(reach)
        return self._rate_pid.update(wanted - turning, turning, interval_s, wanted, saturation)

    def _orbit_rate(self, reach: float) -> float:
        s = self._settings
        rate = s.orbit_m_s / reach if s.orbit_deg_s is None else math.radians(s.orbit_deg_s)
        return clip(rate, s.max_sideways_m_s / reach)

    def _faded(self, wanted: float, interval_s: float) -> float:
        """Begin at the present velocity and let the difference fade."""
        if self._present is not None:
            self._step, self._present = self._present - wanted, None
        else:
            self._step *= math.exp(-interval_s / self._settings.bearing.bumpless_s)
        return wanted + self._step


class OverheadControl:
    """Two loops, north and east, from the target's place below to horizontal velocity.

    The target's own velocity is fed forward. The loops answer the angle off the vertical with a
    velocity over the range, so that their gains hold at any height.
    """

    def __init__(self, settings: ServoSettings) -> None:
        self._settings = settings
        self._range_m = settings.distance_m
        self._north, self._east = (Pid(settings.overhead) for _ in range(2))
        self.change(settings)
        self.start()

    def change(self, settings: ServoSettings) -> None:
        """Go on by other settings, without a step in the loops' outputs."""
        before, self._settings = self._settings, settings
        most = settings.max_forward_m_s / settings.distance_m
        unit = settings.distance_m / before.distance_m
        for loop in (self._north, self._east):
            loop.change(settings.overhead, -most, most, unit, self._range_m / settings.distance_m)

    def start(self, present_m_s: complex = 0.0) -> None:
        """Begin at the present velocity, north + 1j * east, m/s."""
        self._asked = present_m_s
        self._north.start(present_m_s.real / self._settings.distance_m)
        self._east.start(present_m_s.imag / self._settings.distance_m)

    def update(
        self,
        offset: complex,
        range_m: float,
        target: TargetMotion,
        allowed_m_s: complex,
        interval_s: float,
    ) -> complex:
        """Return the horizontal velocity, north + 1j * east, m/s.

        Args:
            offset: horizontal vector to the target, likewise, metres.
            range_m: distance to it.
            target: how it moves.
            allowed_m_s: what the envelope allowed of the last answer.
            interval_s: since the last update.
        """
        distance = self._settings.distance_m
        cut = (self._asked - allowed_m_s) / distance
        angle, ahead = offset / range_m, target.velocity_m_s / distance
        self._range_m, gain = range_m, range_m / distance
        self._asked = distance * complex(
            self._north.update(angle.real, -angle.real, interval_s, ahead.real, cut.real, gain),
            self._east.update(angle.imag, -angle.imag, interval_s, ahead.imag, cut.imag, gain),
        )
        return self._asked

    def heading_error(self, target: TargetMotion, yaw_rad: float) -> float:
        """Return by how much to turn right, rad, for the nose to be where it is wanted."""
        if self._settings.overhead_yaw is OverheadYaw.FREE or target.course_rad is None:
            return 0.0
        return wrap_angle(target.course_rad - yaw_rad)
