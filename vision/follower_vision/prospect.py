"""What is known of the target beside the pixels, told to a tracker before it looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from follower_vision.box import Box


@dataclass(frozen=True, slots=True)
class Forecast:
    """Where the target would be in the next image had it gone on as was believed before.

    What was followed since then may have been something else.

    Attributes:
        since_s: the time stamp of the last frame of which that belief knew.
        cx: where its middle would be, in pixels; beside the image if it left.
        cy: the same downwards.
        likely: where its middle would mostly be.
        nearer: how many times as large it would look as in that frame.
    """

    since_s: float
    cx: float
    cy: float
    likely: Box
    nearer: float


@dataclass(frozen=True, slots=True)
class Prospect:
    """Where in the next image the target can be, as far as its way through the world tells.

    Whoever knows how camera and target move in metres knows of places in the image that no target
    reaches in so short a time, however much what stands there looks like it.

    Attributes:
        cx: where the target's middle should be, in pixels; beside the image if it left.
        cy: the same downwards.
        likely: where its middle mostly is; this, too, may reach beyond the image, or lie outside.
        possible: where it can be at all.
        earlier: the same by what was believed in the last seconds, the latest first.
    """

    cx: float
    cy: float
    likely: Box
    possible: Box
    earlier: tuple[Forecast, ...] = ()


def has_middle(region: Box, box: Box, margin_px: float = 0.0) -> bool:
    """Tell whether a box has its middle in a region, or beside it by no more than a margin."""
    right, down = abs(box.cx - region.cx), abs(box.cy - region.cy)
    return right <= region.width / 2 + margin_px and down <= region.height / 2 + margin_px


@runtime_checkable
class Foresighted(Protocol):
    """What a target tracker offers that makes use of prospects."""

    def expect(self, prospect: Prospect | None) -> None:
        """Take what is known of the next frame alone; None is nothing. Call it before `step`."""
        ...
