"""Recognises a target that was lost among others of its kind.

After Panda and Barczyk, "Blending of Learning-based Tracking and Object Detection for Monocular
Camera-based Target Following" (IFAC 2019): the boxes of the first second are kept as templates; a
candidate's score is the largest, over the templates, of normalised cross-correlation plus the
intersection of colour histograms; it is the target above epsilon = 1.2 of at most 2. Departures:
a second is a second, not a number of frames; the number of templates is bounded; and a small shift
between candidate and template is searched, because detections are never that exact.
"""

import math
from collections.abc import Sequence

from follower_vision.appearance.appearance import (
    Appearance,
    AppearanceGallery,
    appearance_of,
    standard_size,
)
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

EPSILON = 1.2
"""The least score at which a candidate is the target, of at most 2."""
LEARNING_S = 1.0
"""Templates are taken for so long after the start."""
MOST_TEMPLATES = 6
"""They are spread over that time."""
_TEMPLATE_SIDE_PX = 24.0
"""Side of the square of a template's area."""
_SHIFT_RATIO = 0.15
"""How far a candidate may be off, as a share of its side."""


class Reidentifier:
    """Remembers a target's first second and scores candidates against it.

    Attributes:
        size: (width, height) of the templates in pixels.
    """

    def __init__(self) -> None:
        self._templates: list[Appearance] = []
        self._gallery: AppearanceGallery | None = None
        self.size = (0, 0)
        self._started_s = 0.0
        self._taken_s = -math.inf

    @property
    def templates(self) -> Sequence[Appearance]:
        """The first second's views."""
        return tuple(self._templates)

    def start(self, image: Image, box: Box, captured_s: float) -> None:
        """Forget everything and take the first template, (H, W, 3) uint8 BGR."""
        self.size = standard_size(box, _TEMPLATE_SIDE_PX)
        self._templates = []
        self._take(image, box)
        self._started_s = self._taken_s = captured_s

    def learn(self, image: Image, box: Box, captured_s: float) -> bool:
        """Take another template if it is time for one; call it only for boxes that are trusted.

        Returns:
            Whether one was taken.
        """
        if captured_s - self._started_s > LEARNING_S:
            return False
        pause_s = LEARNING_S / MOST_TEMPLATES
        if len(self._templates) >= MOST_TEMPLATES or captured_s < self._taken_s + pause_s:
            return False
        self._take(image, box)
        self._taken_s = captured_s
        return True

    def score(self, image: Image, box: Box) -> float:
        """Return how much a candidate is the target, -1 to 2; `EPSILON` or more: it is.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._gallery is None:
            raise RuntimeError("nothing was learnt yet")
        return self._gallery.likeness(appearance_of(image, box, self.size, _SHIFT_RATIO))

    def best(self, image: Image, candidates: Sequence[Box]) -> tuple[Box, float] | None:
        """Return the candidate with the highest score if it reaches epsilon, with that score."""
        scored = [(box, self.score(image, box)) for box in candidates]
        winner = max(scored, key=lambda pair: pair[1], default=None)
        return winner if winner is not None and winner[1] >= EPSILON else None

    def _take(self, image: Image, box: Box) -> None:
        self._templates.append(appearance_of(image, box, self.size))
        self._gallery = AppearanceGallery(self._templates)
