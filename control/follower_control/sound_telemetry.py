"""Keeps what is no number out of the laws of control."""

from __future__ import annotations

from dataclasses import replace

from follower_control.vehicle import Attitude, LocalPosition, VehicleState


class SoundTelemetry:
    """Puts the last sound attitude and position in the place of those with NaN or infinity.

    They keep their time, and so grow old as if nothing had come.
    """

    def __init__(self) -> None:
        self._attitude: Attitude | None = None
        self._position: LocalPosition | None = None

    def of(self, vehicle: VehicleState) -> VehicleState:
        """Return the state with nothing in it that is not finite."""
        if vehicle.attitude is not self._attitude and _is_sound(vehicle.attitude):
            self._attitude = vehicle.attitude
        if vehicle.position is not self._position and _is_sound(vehicle.position):
            self._position = vehicle.position
        if vehicle.attitude is self._attitude and vehicle.position is self._position:
            return vehicle
        return replace(vehicle, attitude=self._attitude, position=self._position)


def _is_sound(part: Attitude | LocalPosition | None) -> bool:
    return part is None or part.is_finite
