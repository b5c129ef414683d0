"""Looks at a whole image closely enough to see small objects in large images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from follower_vision.box import Box
from follower_vision.detection.detection import Detection, Detector
from follower_vision.frame import Image

_LARGE_PX = 600
_PART = 0.6
_SAME_IOU = 0.45
_SAME_INSIDE = 0.7


def scan(detector: Detector, image: Image) -> list[Detection]:
    """Return what the detector sees in an image and, if it is large, in its four enlarged parts.

    The parts overlap. What a part's edge cuts is left to the others and to the whole image; of two
    boxes of one class about the same object the better stays.

    Args:
        detector: any.
        image: (H, W, 3) uint8 BGR.

    Returns:
        Detections, best first.
    """
    found = detector.detect(image)
    if max(image.shape[:2]) >= _LARGE_PX:
        for part in _parts(image):
            found = [*found, *(one for one in detector.detect(image, part) if not one.cut)]
    return _without_doubles(found)


def _parts(image: Image) -> Iterator[Box]:
    height, width = image.shape[:2]
    across, down = _PART * width, _PART * height
    for left in (0.0, width - across):
        for top in (0.0, height - down):
            yield Box.from_xywh(left, top, across, down)


def _without_doubles(found: Sequence[Detection]) -> list[Detection]:
    kept: list[Detection] = []
    for one in sorted(found, key=lambda detection: -detection.score):
        if not any(_same(one, other) for other in kept):
            kept.append(one)
    return kept


def _same(one: Detection, other: Detection) -> bool:
    if one.class_id != other.class_id:
        return False
    shared = one.box.intersection(other.box)
    inside = shared / min(one.box.area, other.box.area)
    return one.box.iou(other.box) > _SAME_IOU or inside > _SAME_INSIDE
