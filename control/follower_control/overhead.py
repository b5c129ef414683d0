"""Staying above the target, by a camera that looks down."""

from __future__ import annotations

from follower_control.pid import Pid
from follower_control.servo_settings import OverheadYaw, ServoSettings
from follower_control.target_motion import TargetMotion
from follower_vision.lineofsight import wrap_angle


class Overhead:
    """Two loops, north and east, from the target's place below to horizontal velocity.

    The target's own velocity is fed forward. The loops work on the angle off the vertical, so that
    their gains hold at any height.
    """

    def __init__(self, settings: ServoSettings) -> None:
        self._settings = settings
        self._north, self._east = (Pid(settings.overhead) for _ in range(2))
        self.change(settings)
        self.start()

    def change(self, settings: ServoSettings) -> None:
        """Go on by other settings, without a step in the loops' outputs."""
        before, self._settings = self._settings, settings
        most = settings.max_forward_m_s / settings.distance_m
        unit = settings.distance_m / before.distance_m
        for loop in (self._north, self._east):
            loop.change(settings.overhead, -most, most, unit)

    def start(self, present_m_s: complex = 0.0) -> None:
        """Begin at the present velocity, north + 1j * east."""
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
            allowed_m_s: what was let through of the last answer.
            interval_s: since the last update.
        """
        distance = self._settings.distance_m
        cut = (self._asked - allowed_m_s) / distance
        angle, ahead = offset / range_m, target.velocity_m_s / distance
        self._asked = distance * complex(
            self._north.update(angle.real, -angle.real, interval_s, ahead.real, cut.real),
            self._east.update(angle.imag, -angle.imag, interval_s, ahead.imag, cut.imag),
        )
        return self._asked

    def heading_error(self, target: TargetMotion, yaw_rad: float) -> float:
        """Return by how much to turn right, for the nose to be where it is wanted."""
        if self._settings.overhead_yaw is OverheadYaw.FREE or target.course_rad is None:
            return 0.0
        return wrap_angle(target.course_rad - yaw_rad)
