"""Finds places for labels beside boxes where they hide as little as possible."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from follower_vision.box import Box

_GAP_PX = 3.0


def place_labels(
    boxes: Sequence[Box], sizes: Sequence[tuple[float, float]], width: int, height: int
) -> list[tuple[float, float]]:
    """Return the top-left corner of each box's label.

    A label stands above its box unless the image's edge, another box or an earlier label is there;
    then below it or beside it, wherever the least of these is covered.

    Args:
        boxes: what the labels belong to.
        sizes: (width, height) of each label, in pixels.
        width: of the image.
        height: of the image.
    """
    placed: list[Box] = []
    for index, (box, size) in enumerate(zip(boxes, sizes, strict=True)):
        taken = [*placed, *boxes[:index], *boxes[index + 1 :]]
        places = [_inside(place, width, height) for place in _places(box, size)]
        placed.append(min(places, key=lambda place: sum(place.intersection(o) for o in taken)))
    return [(label.left, label.top) for label in placed]


def _places(box: Box, size: tuple[float, float]) -> Iterator[Box]:
    """Yield places around a box, the usual one first."""
    wide, tall = size
    above, below = box.top - tall - _GAP_PX, box.bottom + _GAP_PX
    flush = box.right - wide
    level = box.cy - tall / 2
    if above >= 0:
        yield Box.from_xywh(box.left, above, wide, tall)
    yield Box.from_xywh(box.left, below, wide, tall)
    yield Box.from_xywh(flush, above, wide, tall)
    yield Box.from_xywh(flush, below, wide, tall)
    yield Box.from_xywh(box.right + _GAP_PX, level, wide, tall)
    yield Box.from_xywh(box.left - _GAP_PX - wide, level, wide, tall)
    yield Box.from_xywh(box.left, above - tall, wide, tall)
    yield Box.from_xywh(box.left, below + tall, wide, tall)


def _inside(label: Box, width: int, height: int) -> Box:
    """Move a label into the image; where it is larger than that, its beginning is shown."""
    left = max(0.0, min(label.left, width - label.width))
    top = max(0.0, min(label.top, height - label.height))
    return Box.from_xywh(left, top, label.width, label.height)
