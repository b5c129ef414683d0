"""What was asked of a vehicle and what it did, axis by axis, wherever it was recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from follower_control.tuning.rational import Array
from follower_control.tuning.response_model import ResponseData


class VehicleAxis(StrEnum):
    """What a setpoint asks for."""

    FORWARD = "forward"
    RIGHT = "right"
    DOWN = "down"
    YAW_RATE = "yaw_rate"

    @property
    def is_turn(self) -> bool:
        """Whether it is in radians a second."""
        return self is VehicleAxis.YAW_RATE

    @property
    def least_excitation(self) -> float:
        """Least RMS of the setpoints that is no mere hovering; m/s or rad/s."""
        return 0.03 if self.is_turn else 0.15


@dataclass(frozen=True, slots=True)
class SizeSample:
    """The target's angular size in radians, and its range in metres by other means than size."""

    size_rad: float
    range_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What one recording contains.

    Attributes:
        name: of the file or folder.
        axes: stretches of each axis; an axis that was never asked to move may be missing.
        camera_delays_s: from each frame's capture to the first setpoint made from it.
        frame_intervals_s: from each frame to the next.
        position_ages_s: how old the newest position was at each control step.
        sizes: the target's angular size at which range.
        remarks: what could not be used, in sentences.
        is_excitation: it was flown to be identified; a pursuit seldom excites as much.
    """

    name: str
    axes: Mapping[VehicleAxis, Sequence[ResponseData]]
    camera_delays_s: Sequence[float] = ()
    frame_intervals_s: Sequence[float] = ()
    position_ages_s: Sequence[float] = ()
    sizes: Sequence[SizeSample] = ()
    remarks: Sequence[str] = ()
    is_excitation: bool = True


def is_excited(record: ResponseData, axis: VehicleAxis) -> bool:
    """Whether a stretch asks its axis to move at all."""
    inputs = record.inputs
    return bool(len(inputs) and np.ptp(inputs) > axis.least_excitation)


def in_heading(north: Array, east: Array, yaw_rad: Array) -> tuple[Array, Array]:
    """Return forward and right of what is north and east, (N,) each, in the same unit."""
    cos_yaw, sin_yaw = np.cos(yaw_rad), np.sin(yaw_rad)
    return north * cos_yaw + east * sin_yaw, east * cos_yaw - north * sin_yaw
