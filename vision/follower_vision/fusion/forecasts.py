"""Two forecasts of where the target will be, and which of them to trust."""

from __future__ import annotations

from follower_vision.box import Box

CALM_SIZES = 0.6
"""A place no further away is about the same: the motion tracker sees both at once."""

_LENIENT_SIZES = 1.2
_GOOD_SIZES = 0.35
_MEMORY_FRAMES = 5
_WORST_SIZES = 2.0


class Forecasts:
    """Compares the place ahead, made of the last two images alone, with the one expected.

    What is expected takes in the camera's motion and the target's own over the background. It is
    the better one when the camera swings. But over water, or when the camera follows the target,
    the ground is measured badly while the target hardly moves in the image.
    """

    def __init__(self, box: Box) -> None:
        """Begin with both forecasts at a box, and trust neither more."""
        self._ahead = box
        self._expected: Box | None = None
        self._ahead_error = self._expected_error = 0.0

    def forecast(self, ahead: Box, expected: Box | None) -> None:
        """Take both for the next frame; nothing is expected where no camera motion is measured."""
        self._ahead, self._expected = ahead, expected

    def learn(self, box: Box) -> None:
        """Take where the target was found."""
        if self._expected is None:
            return
        self._ahead_error = _drawn(self._ahead_error, self._ahead, box)
        self._expected_error = _drawn(self._expected_error, self._expected, box)

    @property
    def ahead(self) -> Box:
        """The forecast made of the last two images."""
        return self._ahead

    @property
    def ahead_if_better(self) -> Box | None:
        """The place ahead where it has lately been the better forecast, and a good one."""
        better = self._ahead_error < min(self._expected_error, _GOOD_SIZES)
        return self._ahead if better else None

    def about_ahead(self, place: Box) -> Box:
        """Return the place ahead if another is about the same, the other if not.

        Where the place ahead has lately been the better forecast, and a good one, it may be further
        away.
        """
        reach = CALM_SIZES if self.ahead_if_better is None else _LENIENT_SIZES
        return self._ahead if place.distance(self._ahead) < reach * place.scale else place


def _drawn(error: float, forecast: Box, box: Box) -> float:
    """The mean error in target sizes, as a low-pass; a jump counts as two sizes at most."""
    missed = min(_WORST_SIZES, forecast.distance(box) / box.scale)
    return error + (missed - error) / _MEMORY_FRAMES
