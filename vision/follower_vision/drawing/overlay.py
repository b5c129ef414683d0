"""Draws tracks onto a frame."""

from collections.abc import Iterator, Sequence
from typing import TypeAlias

import cv2
import numpy as np

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.track import Track, TrackState

_GAP_PX = 3.0
Colour: TypeAlias = tuple[int, int, int]
STATE_COLOURS: dict[TrackState, Colour] = {
    TrackState.TRACKING: (90, 220, 60),
    TrackState.COASTING: (0, 190, 255),
    TrackState.LOST: (70, 70, 255),
}
TARGET_COLOURS: tuple[Colour, ...] = (
    (233, 180, 86),
    (40, 150, 255),
    (200, 130, 240),
    (60, 230, 240),
)
"""Of the first target, the second, ...: sky blue, orange, pink, yellow."""
_WHITE: Colour = (245, 245, 245)
_DARK: Colour = (25, 25, 25)
_SUBPIXEL_BITS = 4
_WEIGHT = 600


def place_labels(
    boxes: Sequence[Box],
    sizes: Sequence[tuple[float, float]],
    width: int,
    height: int,
    text: Sequence[Box] = (),
) -> list[tuple[float, float]]:
    """Return the top-left corner of each box's label.

    A label stands above its box unless the image's edge, another box, text or a label is there;
    then below it or beside it, wherever the least of these is covered.

    Args:
        boxes: what the labels belong to.
        sizes: (width, height) of each label, in pixels.
        width: of the image.
        height: of the image.
        text: where else something is written.
    """
    placed = list(text)
    for index, (box, size) in enumerate(zip(boxes, sizes, strict=True)):
        taken = [*placed, *boxes[:index], *boxes[index + 1 :]]
        places = [_inside(place, width, height) for place in _places(box, size)]
        placed.append(min(places, key=lambda place: sum(place.intersection(o) for o in taken)))
    return [(label.left, label.top) for label in placed[len(text) :]]


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


def draw_tracks(image: Image, tracks: Sequence[Track], lines: Sequence[str] = ()) -> Image:
    """Return a copy of `image` with tracks, the image's centre and lines of text on it.

    Args:
        image: (H, W, 3) uint8 BGR, any size.
        tracks: one shows its state and producer. Several are numbered from 1 and have a colour of
            their own each; of a box that is not tracking only the corners are drawn.
        lines: text for the top-left corner.

    Examples:
        >>> import cv2, follower
        >>> frame = next(follower.frames("clip.mp4"))
        >>> with follower.Fusion(follower.Box.from_xywh(190, 100, 40, 40)) as tracker:
        ...     picture = follower.draw_tracks(frame.image, [tracker.step(frame)], ["frame 0"])
        >>> cv2.imwrite("track.png", picture)
        True
    """
    canvas = image.copy()
    unit = _unit(canvas)
    _draw_centre(canvas, unit)
    size = _text_size(unit)
    places = [(size // 2, size // 2 + row * round(1.5 * size)) for row in range(len(lines))]
    shapes = [_label_size(canvas, line, size) for line in lines]
    text = [Box.from_xywh(*at, *shape) for at, shape in zip(places, shapes, strict=True)]
    if len(tracks) == 1:
        _draw_target(canvas, tracks[0], unit, text)
    else:
        _draw_numbered(canvas, tracks, unit, text)
    for line, place in zip(lines, places, strict=True):
        _draw_text(canvas, line, place, _WHITE, size)
    return canvas


def draw_labelled(image: Image, boxes: Sequence[Box], labels: Sequence[str]) -> Image:
    """Return a copy of `image` with labelled boxes on it, in turn in each of `TARGET_COLOURS`."""
    canvas = image.copy()
    unit = _unit(canvas)
    colours = [target_colour(number) for number in range(1, len(boxes) + 1)]
    for box, colour in zip(boxes, colours, strict=True):
        _draw_thick(canvas, box, colour, unit)
    _draw_labels(canvas, boxes, labels, colours, unit, ())
    return canvas


def target_colour(number: int) -> Colour:
    """Return the colour of a target, counted from 1."""
    return TARGET_COLOURS[(number - 1) % len(TARGET_COLOURS)]


def draw_box(canvas: Image, box: Box, colour: Colour, thickness: int = 1) -> None:
    """Draw a box into `canvas` itself, anti-aliased, to a sixteenth of a pixel."""
    corners = [
        (box.left, box.top),
        (box.right, box.top),
        (box.right, box.bottom),
        (box.left, box.bottom),
    ]
    points = np.array([[_fixed(x), _fixed(y)] for x, y in corners], np.int32)
    cv2.polylines(canvas, [points], True, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_target(canvas: Image, track: Track, unit: float, text: Sequence[Box]) -> None:
    colour = STATE_COLOURS[track.state]
    _draw_thick(canvas, track.box, colour, unit)
    arm = min(8 * unit, 0.3 * min(track.box.width, track.box.height))
    _draw_cross(canvas, (track.box.cx, track.box.cy), (0.0, arm), colour, max(1, round(unit)))
    label = f"{track.state.upper()} {track.confidence:.2f} {track.produced_by}"
    _draw_labels(canvas, [track.box], [label], [colour], unit, text)


def _draw_numbered(
    canvas: Image, tracks: Sequence[Track], unit: float, text: Sequence[Box]
) -> None:
    colours = [target_colour(number) for number in range(1, len(tracks) + 1)]
    for track, colour in zip(tracks, colours, strict=True):
        if track.state is TrackState.TRACKING:
            _draw_thick(canvas, track.box, colour, unit)
        else:
            thick = _thickness(track.box, unit)
            _draw_corners(canvas, track.box, _DARK, thick + 2)
            _draw_corners(canvas, track.box, colour, thick)
    labels = [f"{n} {one.state.upper()} {one.confidence:.2f}" for n, one in enumerate(tracks, 1)]
    _draw_labels(canvas, [track.box for track in tracks], labels, colours, unit, text)


def _draw_thick(canvas: Image, box: Box, colour: Colour, unit: float) -> None:
    """Draw a box with a dark rim, which shows on any ground."""
    thick = _thickness(box, unit)
    draw_box(canvas, box, _DARK, thick + 2)
    draw_box(canvas, box, colour, thick)


def _thickness(box: Box, unit: float) -> int:
    return 1 if min(box.width, box.height) < 20 else max(1, round(2 * unit))


def _draw_corners(canvas: Image, box: Box, colour: Colour, thickness: int) -> None:
    across, down = box.width / 4, box.height / 4
    for x, right in ((box.left, across), (box.right, -across)):
        for y, below in ((box.top, down), (box.bottom, -down)):
            corner = (_fixed(x), _fixed(y))
            for end in ((_fixed(x + right), _fixed(y)), (_fixed(x), _fixed(y + below))):
                cv2.line(canvas, corner, end, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_labels(
    canvas: Image,
    boxes: Sequence[Box],
    labels: Sequence[str],
    colours: Sequence[Colour],
    unit: float,
    text: Sequence[Box],
) -> None:
    """Write each label beside its box, always inside the image."""
    size = _text_size(unit)
    sizes = [_label_size(canvas, label, size) for label in labels]
    places = place_labels(boxes, sizes, canvas.shape[1], canvas.shape[0], text)
    for label, (left, top), colour in zip(labels, places, colours, strict=True):
        _draw_text(canvas, label, (round(left), round(top)), colour, size)


def _draw_centre(canvas: Image, unit: float) -> None:
    height, width = canvas.shape[:2]
    centre = (width / 2, height / 2)
    _draw_cross(canvas, centre, (5 * unit, 14 * unit), _DARK, max(1, round(unit)) + 2)
    _draw_cross(canvas, centre, (5 * unit, 14 * unit), _WHITE, max(1, round(unit)))


def _draw_cross(
    canvas: Image,
    centre: tuple[float, float],
    reach: tuple[float, float],
    colour: Colour,
    thickness: int,
) -> None:
    """Draw four arms from the first to the second distance of `reach` about the centre."""
    (x, y), (near, far) = centre, reach
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        start = (_fixed(x + right * near), _fixed(y + down * near))
        end = (_fixed(x + right * far), _fixed(y + down * far))
        cv2.line(canvas, start, end, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_text(
    canvas: Image, text: str, corner: tuple[int, int], colour: Colour, size: int
) -> None:
    """Write on a darkened strip whose top-left corner is given."""
    x, y = corner
    wide, tall = _label_size(canvas, text, size)
    strip = canvas[max(0, y) : y + tall, max(0, x) : x + wide]
    strip[:] = strip // 3
    cv2.putText(canvas, text, (x + 3, y + round(1.05 * size)), colour, _font(), size, _WEIGHT)


def _label_size(canvas: Image, text: str, size: int) -> tuple[int, int]:
    """Return the width and height of the strip behind a text, in pixels."""
    frame = (int(canvas.shape[1]), int(canvas.shape[0]))
    wide = int(cv2.getTextSize(frame, text, (0, 0), _font(), size, _WEIGHT)[2])
    return wide + 6, round(1.4 * size)


def _font() -> cv2.FontFace:
    return cv2.FontFace("sans")


def _unit(canvas: Image) -> float:
    """Line widths and marks grow with the image, 1 at 480 lines, but not in proportion."""
    return float(np.sqrt(max(canvas.shape[0], 120) / 480))


def _text_size(unit: float) -> int:
    return max(11, round(16 * unit))


def _fixed(pixels: float) -> int:
    """Our pixels start at a pixel's corner, OpenCV's at its centre; it wants fixed point."""
    bounded = min(max(pixels, -10_000.0), 30_000.0)
    return round((bounded - 0.5) * (1 << _SUBPIXEL_BITS))
