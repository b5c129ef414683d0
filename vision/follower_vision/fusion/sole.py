"""The only candidate for a lost target, look after look."""

from __future__ import annotations

from collections.abc import Sequence

from follower_vision.box import Box
from follower_vision.fusion.history import History, Moment

_ENOUGH_LOOKS = 5
_LONGEST_GAP_S = 0.4
_MARGIN = 0.2
_SAME_SIZES = 1.0
_MOST_SIZE_RATIO = 2.0


class Sole:
    """Counts how often the same candidate was seen, and nobody else who looks as much like it.

    A target that turned, or that came near and went, need not look like itself. If one of its kind
    is seen ever since where it was lost, and nobody else is as likely, that is it.
    """

    def __init__(self) -> None:
        self._seen: tuple[Moment, Box] | None = None
        self._looks = 0

    def forget(self) -> None:
        """Begin anew."""
        self._seen, self._looks = None, 0

    def persists(
        self,
        scored: Sequence[tuple[float, Box]],
        moment: Moment,
        history: History,
        reach_px: float,
    ) -> bool:
        """Take a look; tell whether the same box has been by far the likest for five looks.

        Args:
            scored: everything of the target's kind that was seen, the likest first, with its
                re-identification score.
            moment: the frame.
            history: the last frames.
            reach_px: how far from `moment.box` the first sight may be.
        """
        if not scored:
            return False
        if any(score > scored[0][0] - _MARGIN for score, _ in scored[1:]):
            self.forget()
            return False
        box = scored[0][1]
        if self._again(box, moment, history):
            self._looks += 1
        else:
            self._looks = 1 if box.distance(moment.box) <= reach_px else 0
        self._seen = moment, box
        return self._looks >= _ENOUGH_LOOKS

    def _again(self, box: Box, moment: Moment, history: History) -> bool:
        if self._seen is None or not self._looks:
            return False
        before, last = self._seen
        place = history.warp(before, moment).box(last)
        ratio = box.scale / place.scale
        recent = moment.captured_s - before.captured_s <= _LONGEST_GAP_S
        near = box.distance(place) <= _SAME_SIZES * place.scale
        return recent and near and 1 / _MOST_SIZE_RATIO < ratio < _MOST_SIZE_RATIO
