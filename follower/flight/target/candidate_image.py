"""The objects that a detector sees in a frame, numbered so that a user can choose."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from follower_vision.detection import Detection
from follower_vision.disk import write_whole_bytes
from follower_vision.drawing.overlay import draw_labelled
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image

_LEAST_WIDTH_PX = 1280
_MOST_ZOOM = 4


@dataclass(frozen=True, slots=True)
class NumberedObject:
    """One object that may be chosen.

    Attributes:
        number: among all, from 1; the nearest to the image's centre is the first.
        class_name: e.g. "person".
        class_number: among those of its class, counted likewise.
        box: in pixels.
        score: the detector's, 0 to 1.
    """

    number: int
    class_name: str
    class_number: int
    box: Box
    score: float

    @property
    def name(self) -> str:
        """Class and number, e.g. "person:2"."""
        return f"{self.class_name}:{self.class_number}"


def numbered(detections: Iterable[Detection], frame: Frame) -> list[NumberedObject]:
    """Return detections as candidates, the nearest to the frame's centre first."""
    middle = Box(frame.width / 2, frame.height / 2, 1, 1)
    seen: Counter[str] = Counter()
    candidates = []
    nearest_first = sorted(detections, key=lambda one: one.box.distance(middle))
    for number, one in enumerate(nearest_first, 1):
        seen[one.class_name] += 1
        candidates.append(
            NumberedObject(number, one.class_name, seen[one.class_name], one.box, one.score)
        )
    return candidates


def summary(candidates: Iterable[NumberedObject]) -> str:
    """Return how many of each class there are: "3 person, 1 car"."""
    counts = Counter(one.class_name for one in candidates)
    return ", ".join(f"{count} {name}" for name, count in counts.most_common()) or "nothing"


def draw_candidates(image: Image, candidates: Sequence[NumberedObject]) -> Image:
    """Return the image, enlarged if it is small, with numbered boxes: "2 person:1"."""
    zoom = min(_MOST_ZOOM, max(1, round(_LEAST_WIDTH_PX / image.shape[1])))
    large = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
    boxes = [
        one.box.scaled(zoom).moved_to(zoom * one.box.cx, zoom * one.box.cy) for one in candidates
    ]
    labels = [f"{one.number} {one.name}" for one in candidates]
    return draw_labelled(np.asarray(large, np.uint8), boxes, labels)


def write_candidates(path: Path, image: Image, candidates: Sequence[NumberedObject]) -> Path:
    """Write the picture of numbered boxes as PNG, whole or not at all; return its path.

    Raises:
        OSError: it cannot be written.
    """
    _, png = cv2.imencode(".png", draw_candidates(image, candidates))
    return write_whole_bytes(path, png.tobytes())
