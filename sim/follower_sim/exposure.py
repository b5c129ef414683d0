"""A picture that is drawn when somebody looks at it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from follower_vision.frame import Frame, Image


class Exposure:
    """What a camera took at one time; drawing it costs time, so that what nobody looks at is not.

    When it is drawn makes no difference to the picture.

    Args:
        draw: returns the picture, the same whenever it is called.
        captured_s: middle of the exposure, on the system's clock.
        sequence: number of the frame.
        size: width and height of the picture.
    """

    def __init__(
        self, draw: Callable[[], Image], captured_s: float, sequence: int, size: tuple[int, int]
    ) -> None:
        self._draw = draw
        self.captured_s = captured_s
        self.sequence = sequence
        self._size = size

    @cached_property
    def frame(self) -> Frame:
        """The picture, drawn now if it was not before."""
        return Frame(self._draw(), self.captured_s, self.sequence)

    @property
    def unseen(self) -> Frame:
        """A black frame with its times and size, for those who do not look at pictures."""
        width, height = self._size
        black = np.broadcast_to(np.zeros((1, 1, 3), np.uint8), (height, width, 3))
        return Frame(black, self.captured_s, self.sequence)

    def replaced(self, draw: Callable[[], Image]) -> Exposure:
        """Return one of the same time that shows something else."""
        return Exposure(draw, self.captured_s, self.sequence, self._size)
