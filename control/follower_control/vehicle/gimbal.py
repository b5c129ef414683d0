"""A short memory of how the gimbal held its camera."""

from __future__ import annotations

from dataclasses import replace

from follower_control.attitude_history import AttitudeHistory
from follower_control.vehicle import GimbalState


class GimbalHistory:
    """Looks up how the camera was held when a frame was taken; used by one thread.

    What its angles are measured against may change: then it begins anew.
    """

    def __init__(self) -> None:
        self._attitudes = AttitudeHistory()
        self._newest: GimbalState | None = None

    def add(self, state: GimbalState) -> bool:
        """Remember a state; False if it is not finite or not newer than the newest one."""
        newest = self._newest
        kind = (state.is_level, state.from_north)
        if newest is not None and kind != (newest.is_level, newest.from_north):
            self._attitudes.clear()
        if not self._attitudes.add(state.attitude):
            return False
        self._newest = state
        return True

    def at(self, time_s: float) -> GimbalState | None:
        """Return the state at a time, None where it is not known."""
        attitude = self._attitudes.at(time_s)
        if attitude is None or self._newest is None:
            return None
        return replace(self._newest, attitude=attitude)
