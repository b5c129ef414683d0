"""An operator's selection of a target, by where it is in the image."""

import math
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

from follower_vision.detection import Detection, Detector
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.selection import box_around

_SLACK = 0.05
"""How far outside the image a finger may land, as a share of it."""
LEAST_SIDE_PX = 4.0


class RequestRefusedError(ValueError):
    """A request cannot be carried out; the message says why, for the operator to read."""


@dataclass(frozen=True, slots=True)
class PointSelection:
    """What is seen at a point.

    Attributes:
        x, y: share of the image's width and height, from its top-left corner.
    """

    x: float
    y: float

    def __post_init__(self) -> None:
        _check(self.x, self.y)

    def on(self, width: int, height: int) -> tuple[float, float]:
        """Return the point in pixels, inside an image of this size."""
        return _inside(self.x) * width, _inside(self.y) * height

    def __str__(self) -> str:
        return f"the point {self.x:.3f}, {self.y:.3f}"


@dataclass(frozen=True, slots=True)
class BoxSelection:
    """What a rectangle shows; two opposite corners, in whichever order.

    Attributes:
        left, top, right, bottom: shares of the image's width and height.
    """

    left: float
    top: float
    right: float
    bottom: float

    def __post_init__(self) -> None:
        _check(self.left, self.top, self.right, self.bottom)
        if self.left == self.right or self.top == self.bottom:
            raise RequestRefusedError("a rectangle needs a width and a height")

    def on(self, width: int, height: int) -> Box:
        """Return the box in pixels, cut to an image of this size.

        Raises:
            RequestRefusedError: it is too small to show anything.
        """
        xs = sorted(_inside(x) * width for x in (self.left, self.right))
        ys = sorted(_inside(y) * height for y in (self.top, self.bottom))
        across, down = xs[1] - xs[0], ys[1] - ys[0]
        if min(across, down) < LEAST_SIDE_PX:
            raise RequestRefusedError(f"{across:.0f} x {down:.0f} pixels are too small a rectangle")
        return Box.from_xywh(xs[0], ys[0], across, down)

    def __str__(self) -> str:
        return f"the box {self.left:.3f}, {self.top:.3f} to {self.right:.3f}, {self.bottom:.3f}"


@dataclass(frozen=True, slots=True)
class ObjectSelection(BoxSelection):
    """A detected object that was seen in a rectangle just before; it may have moved since."""

    def __str__(self) -> str:
        box = f"{self.left:.3f}, {self.top:.3f} to {self.right:.3f}, {self.bottom:.3f}"
        return f"the object seen at {box}"


@dataclass(frozen=True, slots=True)
class ClearSelection:
    """No target any more."""

    def __str__(self) -> str:
        return "no target"


TargetSelection: TypeAlias = PointSelection | BoxSelection | ObjectSelection | ClearSelection


@dataclass(frozen=True, slots=True)
class RequestOutcome:
    """What came of a selection.

    Attributes:
        accepted: it was carried out.
        text: how, or why not; one line for the operator.
        box: the target, in pixels of the frame in which it was chosen; None without one.
    """

    accepted: bool
    text: str
    box: Box | None = None


class TargetRequest:
    """A selection on its way to vision, which carries it out on the next frame.

    Attributes:
        selection: what is wanted.
        by: who asks, in words.
        outcome: what came of it; None while no frame was looked at since.
    """

    def __init__(self, selection: TargetSelection, by: str) -> None:
        self.selection = selection
        self.by = by
        self._settled = threading.Event()
        self.outcome: RequestOutcome | None = None

    def wait(self, timeout_s: float) -> RequestOutcome | None:
        """Wait at most `timeout_s` seconds for the outcome. Never for vision or control."""
        self._settled.wait(timeout_s)
        return self.outcome

    def settle(self, outcome: RequestOutcome) -> None:
        """Say what came of it; for whoever carries it out. The first word stands."""
        if self.outcome is None:
            self.outcome = outcome
            self._settled.set()


def _check(*shares: float) -> None:
    if not all(math.isfinite(share) for share in shares):
        raise RequestRefusedError("a place in the image needs finite numbers")
    if not all(-_SLACK <= share <= 1 + _SLACK for share in shares):
        raise RequestRefusedError("that lies outside the image, which goes from 0 to 1")


def _inside(share: float) -> float:
    return min(max(share, 0.0), 1.0)


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
