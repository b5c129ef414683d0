"""From an operator's selection to the box of what is meant."""

from collections.abc import Iterable

from follower.flight.target.request import (
    ClearSelection,
    ObjectSelection,
    PointSelection,
    RequestOutcome,
    RequestRefusedError,
    TargetSelection,
)
from follower_vision.detection import Detection, Detector
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.selection import box_around

_NEAR = 1.4
"""A finger lands beside small things: a detection counts so many times as large."""
_LOOK_SHARE = 0.35
_MOVED_SHARE = 0.15
"""How far an object may have moved since it was shown, as a share of the image's longer side."""
_MOST_GROWTH = 3.0
"""By how much its area may differ from what was shown: detectors do not agree with themselves."""


class TargetFinder:
    """Finds the target that is meant in a frame.

    Args:
        detector: points snap to what it sees; not used by another thread. None segments alone.
    """

    def __init__(self, detector: Detector | None = None) -> None:
        self._detector = detector

    def find(self, selection: TargetSelection, frame: Frame) -> RequestOutcome:
        """Return what is meant in this frame, or why nothing is."""
        if isinstance(selection, ClearSelection):
            return RequestOutcome(True, "no target any more")
        if isinstance(selection, PointSelection):
            return self._at_point(selection, frame)
        try:
            box = selection.on(frame.width, frame.height)
        except RequestRefusedError as error:
            return RequestOutcome(False, str(error))
        if isinstance(selection, ObjectSelection) and self._detector is not None:
            return self._moved_object(box, frame)
        return RequestOutcome(True, f"{box.width:.0f} x {box.height:.0f} px", box)

    def _at_point(self, selection: PointSelection, frame: Frame) -> RequestOutcome:
        x, y = selection.on(frame.width, frame.height)
        seen = _under(self._seen_near(frame, x, y), x, y)
        if seen is not None:
            return RequestOutcome(True, f"the {seen.class_name} there", seen.box)
        box = box_around(frame.image, x, y)
        if box is None:
            return RequestOutcome(
                False, "nothing stands out there: draw a rectangle around the target"
            )
        return RequestOutcome(
            True, f"what stands out there, {box.width:.0f} x {box.height:.0f} px", box
        )

    def _moved_object(self, box: Box, frame: Frame) -> RequestOutcome:
        """Find the object again: what an operator was shown is older than the newest frame."""
        reach = _MOVED_SHARE * max(frame.width, frame.height)
        seen = _nearest(self._seen_near(frame, box.cx, box.cy), box, reach)
        if seen is None:
            return RequestOutcome(False, "that is not seen there any more: tap it again")
        return RequestOutcome(True, f"the {seen.class_name} there", seen.box)

    def _seen_near(self, frame: Frame, x: float, y: float) -> Iterable[Detection]:
        """Give what the detector sees, first in an enlarged part around the point."""
        if self._detector is None:
            return
        side = _LOOK_SHARE * max(frame.width, frame.height)
        part = Box(x, y, side, side)
        yield from (one for one in self._detector.detect(frame.image, part) if not one.cut)
        yield from self._detector.detect(frame.image)


def _under(detections: Iterable[Detection], x: float, y: float) -> Detection | None:
    """Return the smallest detection at a point, else the nearest one just beside it."""
    near = [one for one in detections if _holds(one.box.scaled(_NEAR), x, y)]
    hit = [one for one in near if _holds(one.box, x, y)]
    return min(hit or near, key=lambda one: one.box.area, default=None)


def _nearest(detections: Iterable[Detection], box: Box, reach: float) -> Detection | None:
    """Return the detection of about this size whose centre is nearest, within reach."""
    alike = [
        one
        for one in detections
        if one.box.distance(box) <= reach
        and 1 / _MOST_GROWTH <= one.box.area / box.area <= _MOST_GROWTH
    ]
    return min(alike, key=lambda one: one.box.distance(box), default=None)


def _holds(box: Box, x: float, y: float) -> bool:
    return box.left <= x <= box.right and box.top <= y <= box.bottom
