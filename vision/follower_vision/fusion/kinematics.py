"""Where the target goes, relative to the background."""

from __future__ import annotations

import math

from follower_vision.box import Box
from follower_vision.fusion.warp import Warp

_MEMORY_S = 0.2
_FADE_S = 1.2
_MOST_SIZES_S = 12.0


class Kinematics:
    """A place carried along with the background and with the target's own velocity.

    The velocity is that over the background, so that a camera that swings does not look like a
    target that runs. It is a first-order low-pass (0.2 s) of what is measured; while nothing is
    measured it fades (1.2 s).
    """

    def __init__(self, box: Box) -> None:
        self._box = box
        self._velocity = (0.0, 0.0)
        self._unseen_s = 0.0

    @property
    def box(self) -> Box:
        """The place believed."""
        return self._box

    @property
    def velocity(self) -> tuple[float, float]:
        """Pixels a second over the background, right and down."""
        return self._velocity

    def advance(self, warp: Warp, interval_s: float) -> Box:
        """Go on to the next image, `interval_s` later, and return the box expected there."""
        right, down = warp.turn(*self._velocity)
        self._velocity = (right, down)
        carried = warp.box(self._box)
        reach_s = interval_s * math.exp(-self._unseen_s / _FADE_S)
        self._box = carried.moved_to(carried.cx + right * reach_s, carried.cy + down * reach_s)
        self._unseen_s += interval_s
        return self._box

    def see(self, box: Box) -> None:
        """Take a box measured in this image as the truth, and learn the velocity from it."""
        if self._unseen_s > 0:
            share = (1 - math.exp(-self._unseen_s / _MEMORY_S)) / self._unseen_s
            right = self._velocity[0] + share * (box.cx - self._box.cx)
            down = self._velocity[1] + share * (box.cy - self._box.cy)
            self._velocity = _limited(right, down, _MOST_SIZES_S * box.scale)
        self.correct(box)

    def correct(self, box: Box) -> None:
        """Take a box as the truth without concluding that the target moved."""
        self._box = box
        self._unseen_s = 0.0

    def restart(self, box: Box, velocity: tuple[float, float] = (0.0, 0.0)) -> None:
        """Begin anew at a box."""
        self._velocity = velocity
        self.correct(box)


def _limited(right: float, down: float, most: float) -> tuple[float, float]:
    speed = math.hypot(right, down)
    factor = min(1.0, most / speed) if speed > 0 else 1.0
    return right * factor, down * factor
