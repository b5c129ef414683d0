"""Velocity across the line of sight: staying on one side of the target, or going round it."""

from __future__ import annotations

import cmath
import math

from follower_control.pid import Pid
from follower_control.servo_settings import Mode, ServoSettings
from follower_control.target_motion import TargetMotion
from follower_vision.lineofsight import wrap_angle


class Sideways:
    """The part of `side` and `orbit` that chasing has not.

    The bearing is that of the vehicle as seen from the target, from north and clockwise. The
    target's own velocity across the line of sight is fed forward.
    """

    def __init__(self, settings: ServoSettings) -> None:
        self._settings = settings
        most = settings.max_sideways_m_s / settings.distance_m
        self._bearing_pid = Pid(settings.bearing, -most, most)
        self._rate_pid = Pid(settings.orbit_rate, -most, most)
        self.start(Mode.CHASE)

    def change(self, settings: ServoSettings) -> None:
        """Go on by other settings; the loops go on where they were."""
        turned = math.radians(settings.side_deg - self._settings.side_deg)
        self._settings = settings
        self._side_rad += turned
        most = settings.max_sideways_m_s / settings.distance_m
        self._bearing_pid.change(settings.bearing, -most, most)
        self._rate_pid.change(settings.orbit_rate, -most, most)

    def start(self, mode: Mode, right_m_s: float = 0.0) -> None:
        """Begin at the present velocity to the right; the side is that of the settings."""
        self._mode = mode
        self._side_rad = math.radians(self._settings.side_deg)
        self._present: float | None = right_m_s
        self._bump = 0.0
        self._asked = right_m_s
        self._bearing_pid.start()
        self._rate_pid.start()

    def update(
        self,
        offset: complex,
        offset_rate: complex,
        target: TargetMotion,
        nudge_m_s: float,
        allowed_m_s: float,
        interval_s: float,
    ) -> float:
        """Return the velocity to the right of the line of sight, m/s.

        Args:
            offset: horizontal vector to the target; north + 1j * east.
            offset_rate: its rate, m/s.
            target: how it moves.
            nudge_m_s: added; `side` moves its side by it.
            allowed_m_s: what was let through of the last answer.
            interval_s: since the last update.
        """
        reach = max(abs(offset), 1.0)
        azimuth = cmath.phase(offset)
        cut = -(self._asked - allowed_m_s) / reach
        if self._mode is Mode.ORBIT:
            turning = (offset_rate * cmath.rect(1.0, -azimuth)).imag / reach
            round_rad_s = self._orbit(turning, reach, cut, interval_s)
        else:
            round_rad_s = self._stay(azimuth, target, nudge_m_s / reach, cut, interval_s)
        # Going to the right takes us round the target against the clock.
        wanted = _across(target.velocity_m_s, azimuth) - round_rad_s * reach + nudge_m_s
        self._asked = self._faded(wanted, interval_s)
        return self._asked

    def _stay(
        self, azimuth: float, target: TargetMotion, nudge: float, cut: float, interval_s: float
    ) -> float:
        """Return the rate of going round the target, positive is clockwise from above."""
        if target.course_rad is None:
            return 0.0
        self._side_rad -= nudge * interval_s
        error = wrap_angle(target.course_rad + self._side_rad - azimuth - math.pi)
        return self._bearing_pid.update(error, -error, interval_s, cut=cut)

    def _orbit(self, turning: float, reach: float, cut: float, interval_s: float) -> float:
        """Return the rate likewise; an autopilot that flies too slowly is asked for more."""
        wanted = self._orbit_rate(reach)
        return self._rate_pid.update(wanted - turning, turning, interval_s, wanted, cut)

    def _orbit_rate(self, reach: float) -> float:
        s = self._settings
        rate = s.orbit_m_s / reach if s.orbit_deg_s is None else math.radians(s.orbit_deg_s)
        most = s.max_sideways_m_s / reach
        return min(max(rate, -most), most)

    def _faded(self, wanted: float, interval_s: float) -> float:
        """Begin at the present velocity and let the difference fade."""
        if self._present is not None:
            self._bump, self._present = self._present - wanted, None
        else:
            self._bump *= math.exp(-interval_s / self._settings.bearing.bumpless_s)
        return wanted + self._bump


def _across(velocity: complex, azimuth: float) -> float:
    """Return what of a velocity goes to the right of a direction."""
    return (velocity * cmath.rect(1.0, -azimuth)).imag
