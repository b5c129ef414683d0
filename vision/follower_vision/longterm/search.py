"""Where a lost target might be."""

from collections.abc import Iterable, Iterator
from itertools import zip_longest

from follower_vision.appearance.template_search import ColourSearch, TemplateSearch, tiles
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

_NEAR_SCALES = ((1.0, 0.8), (1.0, 1.25))
_FAR_SCALES = (1.0, 0.75, 1.33)
_SAME_IOU = 0.5
_MOST = 6


class TargetSearch:
    """Proposes boxes for re-identification, in a bounded time for each frame.

    Three roads: the last good view about where the target may be by now; the same over the whole
    image, one piece a frame; and the target's colours in the whole image, where they stand out.
    """

    def __init__(self) -> None:
        self._template = TemplateSearch()
        self._colour = ColourSearch()
        self._turn = 0

    def learn(self, image: Image, box: Box) -> None:
        """Take a good view of the target, (H, W, 3) uint8 BGR."""
        self._template.learn(image, box)
        self._colour.learn(image, box)
        self._turn = 0

    def near(self, image: Image, expected: Box, reach_px: float) -> list[Box]:
        """Return candidates in a square of side `reach_px` about where the target is expected."""
        self._turn += 1
        scales = _NEAR_SCALES[self._turn % len(_NEAR_SCALES)]
        centre = (expected.cx, expected.cy)
        return self._bounded(self._template.candidates(image, centre, reach_px, scales))

    def everywhere(self, image: Image, expected: Box, reach_px: float) -> list[Box]:
        """Return candidates near the expected place, by colour, and in the next piece."""
        near = self.near(image, expected, reach_px)
        coloured = self._colour.candidates(image)
        side = self._template.reach_px
        pieces = tiles(image.shape[1], image.shape[0], side)
        centre = pieces[self._turn % len(pieces)]
        scale = _FAR_SCALES[self._turn // len(pieces) % len(_FAR_SCALES)]
        far = self._template.candidates(image, centre, side, (scale,))
        return self._bounded(_in_turn(coloured, near, far))

    def _bounded(self, boxes: Iterable[Box]) -> list[Box]:
        """The first few that are not nearly the same."""
        chosen: list[Box] = []
        for box in boxes:
            if all(box.iou(other) < _SAME_IOU for other in chosen):
                chosen.append(box)
            if len(chosen) == _MOST:
                break
        return chosen


def _in_turn(*lists: list[Box]) -> Iterator[Box]:
    """The first of each list, then the second of each, and so on."""
    for group in zip_longest(*lists):
        yield from (box for box in group if box is not None)
