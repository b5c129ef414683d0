"""The seam for object detectors: an image in, boxes with classes out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from follower_vision.box import Box
from follower_vision.frame import Image


@dataclass(frozen=True, slots=True)
class Detection:
    """One object that a detector sees.

    Attributes:
        box: in pixels of the whole image, also when only a region was looked at.
        class_id: the class's number in the detector's own list.
        class_name: e.g. "person".
        score: 0 to 1; comparable for one detector, not between detectors.
        cut: the box ends at the edge of the region looked at, so that the object may go on.
    """

    box: Box
    class_id: int
    class_name: str
    score: float
    cut: bool = False


class Detector(Protocol):
    """Finds objects of known classes in an image; remembers nothing between images."""

    @property
    def class_names(self) -> tuple[str, ...]:
        """The names of all classes that it knows, by their numbers."""
        ...

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """Return what is to be seen, best first.

        Args:
            image: (H, W, 3) uint8 BGR.
            region: look only here, enlarged; None is the whole image. It may reach beyond the
                image. An object counts where its centre lies within the region.
        """
        ...
