"""The target's mean motion in the image, to search where it is going."""

from __future__ import annotations

from follower_vision.box import Box


class Drift:
    """Averages the steps between boxes, in pixels a frame.

    A motion tracker knows no time; where frames drop, the step grows for one frame, and only the
    middle of the search region is a little off.

    Args:
        rate: share of the newest step in the average.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._right = 0.0
        self._down = 0.0

    def stop(self) -> None:
        """Forget the motion."""
        self._right = self._down = 0.0

    def follow(self, before: Box, after: Box) -> None:
        """Take one step into the average."""
        self._right += self._rate * (after.cx - before.cx - self._right)
        self._down += self._rate * (after.cy - before.cy - self._down)

    def moved(self, box: Box, share: float) -> Box:
        """Return the box moved by a share of the mean step."""
        return box.moved_to(box.cx + share * self._right, box.cy + share * self._down)
