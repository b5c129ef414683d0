"""An operator's selection of a target, by where it is in the image."""

import math
import threading
from dataclasses import dataclass
from typing import TypeAlias

from follower_vision.geometry.box import Box

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
