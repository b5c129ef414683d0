"""Recognises a target that was lost among others of its kind.

After Panda and Barczyk, "Blending of Learning-based Tracking and Object Detection for Monocular
Camera-based Target Following" (IFAC 2019): the boxes of the first second are kept as templates; a
candidate's score is the largest, over the templates, of normalised cross-correlation plus the
intersection of colour histograms; it is the target above epsilon = 1.2 of at most 2. Departures:
a second is a second, not a number of frames; the number of templates is bounded; a small shift
between candidate and template is searched, because detections are never that exact; and, unless
`max_recent` is 0, a few recent views that were themselves recognised count as templates too,
because a target seen from behind at first may have turned since.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from follower_vision.appearance.appearance import (
    Appearance,
    AppearanceGallery,
    appearance_of,
    standard_size,
)
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image


@dataclass(frozen=True, slots=True)
class ReidentifySettings:
    """How a target is remembered and recognised.

    Attributes:
        epsilon: least score, between 0 and 2, at which a candidate is the target.
        learning_s: templates are taken during this time after the start.
        max_templates: how many at most, spread over that time.
        max_recent: how many later views are kept besides; 0 is the paper.
        template_side_px: side of the square of a template's area.
        shift_ratio: how far a candidate may be off, as a share of its side.
    """

    epsilon: float = 1.2
    learning_s: float = 1.0
    max_templates: int = 6
    max_recent: int = 3
    template_side_px: float = 24.0
    shift_ratio: float = 0.15

    def __post_init__(self) -> None:
        if not 0 < self.epsilon < 2:
            raise ValueError(f"re-identification: epsilon lies between 0 and 2, not {self.epsilon}")
        if not 0 <= self.learning_s < math.inf or self.max_templates < 1:
            raise ValueError("re-identification needs a finite time to learn and a template")
        if self.max_recent < 0:
            raise ValueError("re-identification: max_recent is 0 or more")
        if self.template_side_px < 8 or not 0 <= self.shift_ratio < 0.5:
            raise ValueError(
                "re-identification: template_side_px is at least 8, shift_ratio below 0.5"
            )


class Reidentifier:
    """Remembers a target's first second and scores candidates against it.

    Attributes:
        size: (width, height) of the templates in pixels.
    """

    def __init__(self, settings: ReidentifySettings | None = None) -> None:
        self._settings = settings or ReidentifySettings()
        self._templates: list[Appearance] = []
        self._recent: deque[Appearance] = deque(maxlen=self._settings.max_recent)
        self._all: AppearanceGallery | None = None
        self._first: AppearanceGallery | None = None
        self.size = (0, 0)
        self._started_s = 0.0
        self._taken_s = -math.inf

    @property
    def templates(self) -> Sequence[Appearance]:
        """What is remembered: the first second's views, then the recent ones."""
        return (*self._templates, *self._recent)

    @property
    def epsilon(self) -> float:
        """The least score of the target."""
        return self._settings.epsilon

    def start(self, image: Image, box: Box, captured_s: float) -> None:
        """Forget everything and take the first template, (H, W, 3) uint8 BGR."""
        self.size = standard_size(box, self._settings.template_side_px)
        self._templates = [appearance_of(image, box, self.size)]
        self._recent.clear()
        self._collect()
        self._started_s = self._taken_s = captured_s

    def learn(self, image: Image, box: Box, captured_s: float) -> bool:
        """Take another template if it is time for one; call it only for boxes that are trusted.

        Returns:
            Whether one was taken.
        """
        settings = self._settings
        pause_s = settings.learning_s / settings.max_templates
        if captured_s - self._started_s > settings.learning_s:
            return False
        if len(self._templates) >= settings.max_templates or captured_s < self._taken_s + pause_s:
            return False
        self._templates.append(appearance_of(image, box, self.size))
        self._collect()
        self._taken_s = captured_s
        return True

    def refresh(self, image: Image, box: Box) -> None:
        """Remember a later view, in place of the oldest such; only one that was recognised."""
        self._recent.append(appearance_of(image, box, self.size))
        self._collect()

    def score(self, image: Image, box: Box) -> float:
        """Return how much a candidate is the target, -1 to 2; `epsilon` or more: it is.

        Raises:
            RuntimeError: `start` was not called.
        """
        return self._compare(image, box, self._all, self._settings.shift_ratio)

    def fit(self, image: Image, box: Box) -> float:
        """Return how exactly a box shows the target, -1 to 2: no shift, the first second's views.

        Raises:
            RuntimeError: `start` was not called.
        """
        return self._compare(image, box, self._first, 0.0)

    def _collect(self) -> None:
        self._all, self._first = (
            AppearanceGallery(self.templates),
            AppearanceGallery(self._templates),
        )

    def _compare(
        self, image: Image, box: Box, known: AppearanceGallery | None, shift_ratio: float
    ) -> float:
        if known is None:
            raise RuntimeError("nothing was learnt yet")
        return known.likeness(appearance_of(image, box, self.size, shift_ratio))

    def best(self, image: Image, candidates: Sequence[Box]) -> tuple[Box, float] | None:
        """Return the candidate with the highest score if it reaches epsilon, with that score."""
        scored = [(box, self.score(image, box)) for box in candidates]
        winner = max(scored, key=lambda pair: pair[1], default=None)
        return winner if winner is not None and winner[1] >= self._settings.epsilon else None
