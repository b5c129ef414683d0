"""Small pictures cut from frames, with boxes drawn into them."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import cv2
import numpy as np

from follower.report import html
from follower.report.style import Colour
from follower_vision.box import Box
from follower_vision.frame import Image

_WIDTH, _HEIGHT = 400, 300
_SHAPE = _WIDTH / _HEIGHT
_MARGIN = 1.2
_FULL_COLOUR = 0x111111
"""JPEG's 4:4:4: thin lines keep their colour."""
_LEAST_SIDES = 6.0
_LEAST_PX = 120.0


def figure(image: Image, title: str, caption: str) -> str:
    """Return a picture that the page carries in itself, with what it shows."""
    how = [cv2.IMWRITE_JPEG_QUALITY, 75, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, _FULL_COLOUR]
    _, coded = cv2.imencode(".jpg", image, how)
    data = base64.b64encode(coded.tobytes()).decode("ascii")
    name, said = html.text_of(title), html.text_of(caption)
    return (
        f'<figure><img alt="{name}, {said}" width="{_WIDTH}" height="{_HEIGHT}" loading="lazy" '
        f'src="data:image/jpeg;base64,{data}"><figcaption><b>{name}</b> {said}</figcaption>'
        "</figure>"
    )


def window_of(image: Image, boxes: Sequence[Box | None]) -> Box:
    """Return the part to show, of the picture's shape: the boxes with room around the target."""
    height, width = image.shape[:2]
    known = [box for box in boxes if box is not None] or [Box(width / 2, height / 2, width, height)]
    left, right = min(box.left for box in known), max(box.right for box in known)
    top, bottom = min(box.top for box in known), max(box.bottom for box in known)
    room = max(_LEAST_PX, _LEAST_SIDES * known[0].scale)
    across = max(_MARGIN * (right - left), room, _MARGIN * (bottom - top) * _SHAPE)
    across = min(across, max(width, height * _SHAPE))
    down = across / _SHAPE
    cx, cy = (_within((left + right) / 2, across, width), _within((top + bottom) / 2, down, height))
    return Box(cx, cy, across, down)


def _within(centre: float, side: float, whole: float) -> float:
    """Move a window's centre so that it lies in the image; what is larger goes to its middle."""
    return whole / 2 if side >= whole else min(max(centre, side / 2), whole - side / 2)


def cut(image: Image, window: Box) -> Image:
    """Return the window at the picture's size; what lies outside the image is grey."""
    scale = _WIDTH / window.width
    shift = np.array([[scale, 0, -window.left * scale], [0, scale, -window.top * scale]])
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    grey = (128, 128, 128)
    part = cv2.warpAffine(image, shift, (_WIDTH, _HEIGHT), flags=flags, borderValue=grey)
    return np.asarray(part, np.uint8)


def draw(image: Image, box: Box | None, window: Box, colour: Colour, label: str = "") -> None:
    """Draw a box into the picture that was cut by `window`, nothing for None."""
    if box is None:
        return
    scale = _WIDTH / window.width
    edges = np.array([box.left, box.top, box.right, box.bottom])
    moved = (edges - [window.left, window.top, window.left, window.top]) * scale
    left, top, right, bottom = (int(edge) for edge in np.clip(moved, -1e4, 1e4))
    red, green, blue = bytes.fromhex(colour.light[1:])
    cv2.rectangle(image, (left, top), (right, bottom), (blue, green, red), 2, cv2.LINE_AA)
    if label:
        _draw_label(image, label, (left, top), (blue, green, red))


def _draw_label(
    image: Image, label: str, corner: tuple[int, int], tint: tuple[int, int, int]
) -> None:
    """Write white on the box's colour, above the box where there is room."""
    wide, high = 6 + 9 * len(label), 16
    left = min(max(corner[0], 0), _WIDTH - wide)
    top = min(max(corner[1] - high, 0), _HEIGHT - high)
    cv2.rectangle(image, (left, top), (left + wide, top + high), tint, cv2.FILLED)
    place = (left + 3, top + high - 4)
    white = (255, 255, 255)
    cv2.putText(image, label, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, white, 1, cv2.LINE_AA)
