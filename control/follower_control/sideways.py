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
        self.start(Mode.CHASE)

    def start(self, mode: Mode, right_m_s: float = 0.0) -> None:
        """Begin at the present velocity to the right; the side is that of the settings."""
        self._mode = mode
        self._side_rad = math.radians(self._settings.side_deg)
        self._present: float | None = right_m_s
        self._bump = 0.0
        self._asked = right_m_s
        self._bearing_pid.start()

    def update(
        self,
        offset: complex,
        target: TargetMotion,
        nudge_m_s: float,
        allowed_m_s: float,
        interval_s: float,
    ) -> float:
        """Return the velocity to the right of the line of sight, m/s.

        Args:
            offset: horizontal vector to the target; north + 1j * east.
            target: how it moves.
            nudge_m_s: added; `side` moves its side by it.
            allowed_m_s: what was let through of the last answer.
            interval_s: since the last update.
        """
        reach = max(abs(offset), 1.0)
        azimuth = cmath.phase(offset)
        round_rad_s = self._round(azimuth, target, nudge_m_s, reach, allowed_m_s, interval_s)
        # Going to the right takes us round the target against the clock.
        wanted = _across(target.velocity_m_s, azimuth) - round_rad_s * reach + nudge_m_s
        self._asked = self._faded(wanted, interval_s)
        return self._asked

    def _round(
        self,
        azimuth: float,
        target: TargetMotion,
        nudge_m_s: float,
        reach: float,
        allowed_m_s: float,
        interval_s: float,
    ) -> float:
        """Return the rate of going round the target, positive is clockwise from above."""
        if self._mode is Mode.ORBIT:
            return self._orbit_rate(reach)
        if target.course_rad is None:
            return 0.0
        self._side_rad -= nudge_m_s * interval_s / reach
        bearing = azimuth + math.pi
        error = wrap_angle(target.course_rad + self._side_rad - bearing)
        cut = -(self._asked - allowed_m_s) / reach
        return self._bearing_pid.update(error, -error, interval_s, cut=cut)

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
