"""Whether the image moves as the vehicle's attitude says it must, when it is turned by hand.

A target that stands still moves in the image because the camera turns. How the camera turns, the
autopilot's attitude and the mount's angles say; from that follows where in the image the target
has to be next. The two-by-two matrix A that takes the motion expected into the motion seen, fitted
by least squares, is the identity for a camera that is mounted as described. Of a mirrored one it
is diag(-1, 1), of one upside down -1, of one on its side a quarter turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from follower_control.vehicle import Attitude
from follower_vision.camera import Vector
from follower_vision.lineofsight import CameraMount, rotation

_LEAST_INTERVAL_S, _LONGEST_INTERVAL_S = 0.15, 0.6
_FORGET = 0.99
_ENOUGH_RAD = math.radians(40)
_PLENTY_RAD = math.radians(90)
_LITTLE_RAD = math.radians(15)
_RIDGE = math.radians(1) ** 2
_CLEAR, _SMALL = 0.5, 0.5
_LEAST_GAIN, _MOST_GAIN = 0.75, 1.33


class Sign(StrEnum):
    """What is known about one direction in the image."""

    WAITING = "waiting"
    RIGHT = "right"
    REVERSED = "reversed"
    TURNED_RIGHT = "turned a quarter clockwise"
    TURNED_LEFT = "turned a quarter anticlockwise"
    UNCLEAR = "unclear"

    @property
    def is_wrong(self) -> bool:
        """Whether the camera does not see as the settings say."""
        return self not in (Sign.WAITING, Sign.RIGHT)


@dataclass(frozen=True, slots=True)
class Judgement:
    """What is known of the image's two directions.

    Attributes:
        across: rightwards.
        down: downwards.
        gain_across: motion seen over motion expected, 1 if the lens is as described; NaN before
            there is enough.
        gain_down: likewise.
        share_across: how much of the motion needed was made, 0 to 1.
        share_down: likewise.
        attitude_stands: the image moves much and the attitude hardly.
    """

    across: Sign
    down: Sign
    gain_across: float
    gain_down: float
    share_across: float
    share_down: float
    attitude_stands: bool

    @property
    def passed(self) -> bool:
        """Whether both directions are right."""
        return self.across is self.down is Sign.RIGHT

    @property
    def is_wrong(self) -> bool:
        """Whether one of them is known to be wrong."""
        return self.across.is_wrong or self.down.is_wrong


class Evidence:
    """Collects what was seen, and forgets it slowly: a target may be moved, and stand again.

    Args:
        mount: as the settings describe it.
    """

    def __init__(self, mount: CameraMount) -> None:
        self._camera_to_body = mount.camera_to_body
        self._last: tuple[float, Vector, Vector] | None = None
        self._expected = np.zeros((2, 2))
        self._both = np.zeros((2, 2))
        self._expected_path = np.zeros(2)
        self._seen_path = 0.0

    def add(self, time_s: float, ray: Vector, attitude: Attitude) -> None:
        """Take where the target was seen, and the attitude at that time.

        Args:
            time_s: when the image was taken.
            ray: the target's direction in the camera's frame, a unit vector.
            attitude: of the body at that time.
        """
        camera_to_world = (
            rotation(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) @ self._camera_to_body
        )
        if self._last is not None:
            last_s, last_ray, last_turn = self._last
            if 0 <= time_s - last_s < _LEAST_INTERVAL_S:
                return
            if 0 <= time_s - last_s <= _LONGEST_INTERVAL_S:
                expected = _angles(camera_to_world.T @ last_turn @ last_ray) - _angles(last_ray)
                self._fold_in(expected, _angles(ray) - _angles(last_ray))
        self._last = time_s, ray, camera_to_world

    def judge(self) -> Judgement:
        """Return what is known by now."""
        matrix = self._both @ np.linalg.inv(self._expected + _RIDGE * np.eye(2))
        across, down = (self._sign(matrix, axis) for axis in (0, 1))
        shares = np.minimum(self._expected_path / _ENOUGH_RAD, 1.0)
        gains = np.where(shares >= 1.0, np.diag(matrix), np.nan)
        stands = self._seen_path > _PLENTY_RAD and self._expected_path.sum() < _LITTLE_RAD
        return Judgement(
            across,
            down,
            float(gains[0]),
            float(gains[1]),
            float(shares[0]),
            float(shares[1]),
            bool(stands),
        )

    def _fold_in(self, expected: Vector, seen: Vector) -> None:
        for sums in (self._expected, self._both, self._expected_path):
            sums *= _FORGET
        self._expected += np.outer(expected, expected)
        self._both += np.outer(seen, expected)
        self._expected_path += np.abs(expected)
        self._seen_path = _FORGET * self._seen_path + float(np.abs(seen).sum())

    def _sign(self, matrix: Vector, axis: int) -> Sign:
        if self._expected_path[axis] < _ENOUGH_RAD:
            return Sign.WAITING
        along, aside = matrix[axis, axis], matrix[1 - axis, axis]
        if abs(along) >= _CLEAR and abs(aside) < _SMALL * max(1.0, abs(along)):
            return Sign.RIGHT if along > 0 else Sign.REVERSED
        if abs(aside) >= _CLEAR and abs(along) < _SMALL:
            clockwise = aside > 0 if axis == 0 else aside < 0
            return Sign.TURNED_RIGHT if clockwise else Sign.TURNED_LEFT
        return Sign.UNCLEAR


def gain_remark(gain: float) -> str:
    """Return what a gain says about the lens, "" if nothing."""
    if math.isnan(gain) or _LEAST_GAIN <= gain <= _MOST_GAIN:
        return ""
    how = "less" if gain < 1 else "more"
    # The lens turns pixels into angles: too wide a field of view makes them too large.
    wrong = "too narrow" if gain < 1 else "too wide"
    return (
        f"the image moves {gain:.1f} times as far as the attitude says, {how} than it should: "
        f"is the target far enough (5 m), is camera.fov_deg {wrong}?"
    )


def _angles(ray: Vector) -> Vector:
    """Return the angles right and down of the optical axis."""
    return np.array([math.atan2(ray[0], ray[2]), math.atan2(ray[1], ray[2])])
