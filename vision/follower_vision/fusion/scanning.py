"""The order in which places around a lost target are looked at."""

from __future__ import annotations

from functools import lru_cache

from follower_vision.box import Box

_RINGS = 12


def around(box: Box, step_px: float, turn: int, width: int, height: int) -> Box:
    """Return the place of a turn: ring after ring about a box, those outside the image left out.

    Args:
        box: where the target was expected.
        step_px: how far neighbouring places are apart.
        turn: 0, 1, 2 ...; after the last place it begins again.
        width: the image's width in pixels.
        height: the image's height in pixels.
    """
    places = [
        (x, y)
        for across, down in _spiral()
        if 0 <= (x := box.cx + across * step_px) <= width
        and 0 <= (y := box.cy + down * step_px) <= height
    ]
    return box.moved_to(*places[turn % len(places)]) if places else box


@lru_cache(maxsize=1)
def _spiral() -> tuple[tuple[int, int], ...]:
    """Squares of a grid, the nearer ones first, without the middle."""
    reach = range(-_RINGS, _RINGS + 1)
    squares = [(x, y) for x in reach for y in reach if (x, y) != (0, 0)]
    return tuple(sorted(squares, key=lambda square: (max(map(abs, square)), square)))
