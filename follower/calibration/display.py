"""Shows, while images come, which parts of the image are covered and what to do next."""

from __future__ import annotations

from rich.console import Group
from rich.text import Text

from follower.calibration.coverage import Coverage
from follower.calibration.views import ViewCollection

GOOD_VIEWS, GOOD_COVERAGE = 20, 0.8
_TILTED_DEG, _TILTED_VIEWS = 15.0, 6
_FULL, _SOME, _NONE = "██", "▒▒", "··"


def is_enough(views: ViewCollection) -> bool:
    """Whether more views would tell little more."""
    return views.full or (len(views.views) >= GOOD_VIEWS and advice(views) == "")


def advice(views: ViewCollection) -> str:
    """Return what to show next, "" if nothing is missing but views."""
    if views.size is None or not views.views:
        return "show the board to the camera"
    coverage = Coverage(views.views, views.size)
    tilted = sum(view.tilt_deg > _TILTED_DEG for view in views.views)
    if coverage.share < GOOD_COVERAGE and (missing := coverage.missing()):
        return f"show it at the {missing[0]}"
    if tilted < _TILTED_VIEWS:
        return "tilt it by 30 degrees, to each side, and up and down"
    return ""


def counts_line(views: ViewCollection) -> str:
    """Return what was seen so far in a line."""
    return (
        f"{views.images} images: {len(views.views)} views kept, {views.known} like one of these, "
        f"{views.blurred} blurred, {views.without_board} without the board"
    )


def shown(views: ViewCollection, board_in_sight: bool) -> Group:
    """Return the coverage as a picture of characters, the numbers, and what to do next."""
    rows = []
    if views.size is not None:
        for counts in Coverage(views.views, views.size).counts:
            rows.append(Text(" ".join(_cell(int(count)) for count in counts)))
    sight = "the board is in sight" if board_in_sight else "no board in sight"
    todo = advice(views) or f"{max(0, GOOD_VIEWS - len(views.views))} views more, of any kind"
    return Group(*rows, Text(counts_line(views)), Text(f"{sight}; next: {todo}", style="bold"))


def _cell(count: int) -> str:
    return _NONE if count == 0 else _FULL if count >= 3 else _SOME
