"""Ways to point out the target."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from follower.vision_stage import Selector
from follower_control.strict_yaml import SettingsError
from follower_vision.acquire import ColourSearchSettings, colour_from_hex, find_by_colour
from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.framesource import SourceError

TargetsSelector: TypeAlias = Callable[[Frame], list[Box]]
"""Finds the boxes of all targets in a frame, or none while one is not there (yet)."""

_LEAST_IN_IMAGE = 0.5


def box_selector(target: Box) -> Selector:
    """Select what `target` shows in the next frame.

    The selector raises SourceError if less than half of the box lies in the image.
    """

    def select(frame: Frame) -> Box:
        share = target.visible_share(frame.width, frame.height)
        if share < _LEAST_IN_IMAGE:
            where = "outside" if share == 0 else f"with {share:.0%} of it only in"
            x, y, width, height = target.xywh
            raise SourceError(
                f"the target {x:g},{y:g},{width:g},{height:g} lies {where} the image, which is "
                f"{frame.width}x{frame.height}: give x,y,w,h of a box in the first frame"
            )
        return target

    return select


def colour_selector(
    colour: str,
    search: ColourSearchSettings | None = None,
    pointed: Callable[[Frame], Box | None] | None = None,
) -> Selector:
    """Select the best thing of a colour ("#rrggbb"), as soon as one is seen.

    Args:
        colour: what it has.
        search: how like that it has to be.
        pointed: where in a frame somebody points who knows which of several is meant; what has its
            middle no farther than a size from there is meant. None: the best by itself.

    Raises:
        SettingsError: the text is no colour.
    """
    try:
        wanted = colour_from_hex(colour)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    settings = search or ColourSearchSettings()

    def select(frame: Frame) -> Box | None:
        candidates = find_by_colour(frame.image, wanted, settings)
        if pointed is None:
            return candidates[0] if candidates else None
        meant = pointed(frame)
        if meant is None:
            return None
        candidates = [box for box in candidates if box.distance(meant) < meant.scale]
        return min(candidates, key=meant.distance, default=None)

    return select


def all_selected(selectors: Sequence[Selector]) -> TargetsSelector:
    """Select several targets, in the first frame in which all of them are found."""

    def select(frame: Frame) -> list[Box]:
        found = [selector(frame) for selector in selectors]
        boxes = [box for box in found if box is not None]
        return boxes if len(boxes) == len(found) else []

    return select
