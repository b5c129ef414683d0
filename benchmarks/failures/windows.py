"""Variants in which the camera, the rate or the size differs: each frame is cut from the clip's."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from failures.clip import Clip
from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image

MOST_FRAMES = 150
_LEAST_VISIBLE = 0.3
_SWUNG, _TURNED = 0.75, 0.5
_ZOOMED = 0.6
_NARROWEST = 0.35
_LEAST_VIEW_SIZES = 3.0
_ZOOM_PERIOD = 150
_BLACK = (0.0, 0.0, 0.0)

Vector = npt.NDArray[np.float64]


def shortened(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Leave everything as it is."""
    return picked(clip, range(len(clip)))


def backwards(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Play the clip backwards."""
    last = max(k for k, box in enumerate(clip.truth) if box is not None)
    return picked(clip, range(last, -1, -1))


def skipping(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Take every second or third frame, at the same rate: everything moves faster."""
    return picked(clip, range(0, len(clip), 3 if len(clip) >= 240 else 2))


def low_rate(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Take every third frame, at a third of the rate."""
    return picked(clip, range(0, len(clip), 3), clip.rate_hz / 3)


def half_size(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Halve the image."""
    clip = picked(clip, range(len(clip)))
    width, height = clip.size[0] // 2, clip.size[1] // 2
    whole = Box.from_xywh(0, 0, *clip.size)
    return _viewed(clip, [whole] * len(clip), width, height)


def jerk(clip: Clip, rng: np.random.Generator) -> Clip:
    """Swing the camera at random every fifth frame."""
    clip = picked(clip, range(len(clip)))
    size, places = _window_size(clip, _SWUNG), []
    aim = place = _centred(clip, 0, size)
    fastest = max(12.0, 1.2 * clip.start.scale)
    for number in range(len(clip)):
        if number % 5 == 0 and number:
            aim = _centred(clip, number, size) + rng.uniform(-0.33, 0.33, 2) * size
        place = _kept(clip, place + np.clip(aim - place, -fastest, fastest), size)
        places.append(place)
    return _panned(clip, places, size)


def looking_away(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Turn the camera until the target leaves the image for about half a second, and back."""
    return _turning(clip, lambda number: number % 60 >= 30 and number % 60 < 48)


def leaving(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Turn the camera until the target leaves the image for about two seconds, and back."""
    return _turning(clip, lambda number: 20 <= number < 85)


def zoom(clip: Clip, rng: np.random.Generator) -> Clip:  # noqa: ARG001
    """Zoom in and out: the target's size changes by a factor of nearly three."""
    clip = picked(clip, range(len(clip)))
    width, height = (int(side * _ZOOMED) for side in clip.size)
    box, views = clip.start, []
    filled = max(box.width / clip.size[0], box.height / clip.size[1])
    narrowest = min(1.0, max(_NARROWEST, _LEAST_VIEW_SIZES * filled))
    for number in range(len(clip)):
        wave = 0.5 - 0.5 * np.cos(2 * np.pi * number / _ZOOM_PERIOD)
        share = narrowest ** (1 - wave)
        size = np.array(clip.size) * share
        place = _kept(clip, _centred(clip, number, size), size)
        views.append(Box.from_xywh(*place, *size))
    return _viewed(clip, views, width, height)


def picked(clip: Clip, order: Sequence[int], rate_hz: float | None = None) -> Clip:
    """Return the frames of these numbers, as many as a variant may have."""
    order = list(order)[:MOST_FRAMES]
    return Clip(
        clip.name,
        [clip.truth[number] for number in order],
        lambda number: clip.picture(order[number]),
        clip.size,
        rate_hz or clip.rate_hz,
    )


def _turning(clip: Clip, away: Callable[[int], bool]) -> Clip:
    clip = picked(clip, range(len(clip)))
    size, places = _window_size(clip, _TURNED), []
    place = _centred(clip, 0, size)
    for number in range(len(clip)):
        aim, fastest = _centred(clip, number, size), 0.04 * clip.size[0]
        if away(number):
            box, fastest = _last_box(clip, number), 0.06 * clip.size[0]
            beside = box.right + 0.3 * box.scale
            if box.cx >= clip.size[0] / 2:
                beside = box.left - 0.3 * box.scale - size[0]
            aim = np.array([beside, place[1]])
        place = _kept(clip, place + np.clip(aim - place, -fastest, fastest), size)
        places.append(place)
    return _panned(clip, places, size)


def _window_size(clip: Clip, share: float) -> Vector:
    return np.floor(np.array(clip.size) * share)


def _last_box(clip: Clip, number: int) -> Box:
    seen = [box for box in clip.truth[: number + 1] if box is not None]
    return seen[-1]


def _centred(clip: Clip, number: int, size: Vector) -> Vector:
    """The window's top left corner, the target in its middle."""
    box = _last_box(clip, number)
    return _kept(clip, np.array([box.cx, box.cy]) - size / 2, size)


def _kept(clip: Clip, place: Vector, size: Vector) -> Vector:
    return np.clip(place, 0, np.array(clip.size) - size)


def _panned(clip: Clip, places: Sequence[Vector], size: Vector) -> Clip:
    views = [Box.from_xywh(*np.floor(place), *size) for place in places]
    return _viewed(clip, views, int(size[0]), int(size[1]))


def _viewed(clip: Clip, views: Sequence[Box], width: int, height: int) -> Clip:
    """Return the clip as a camera sees it that shows a rectangle of each image."""

    def picture(number: int) -> Image:
        return crop(clip.picture(number), views[number], width, height, _BLACK)

    boxes = [_moved(box, view, width) for box, view in zip(clip.truth, views, strict=True)]
    shares = [0.0 if box is None else box.visible_share(width, height) for box in boxes]
    truth = [
        box if share >= _LEAST_VISIBLE else None for box, share in zip(boxes, shares, strict=True)
    ]
    edge = frozenset(k for k, share in enumerate(shares) if 0 < share < _LEAST_VISIBLE)
    return Clip(clip.name, truth, picture, (width, height), clip.rate_hz, edge=edge)


def _moved(box: Box | None, view: Box, width: int) -> Box | None:
    """The box in the view's pixels."""
    if box is None:
        return None
    factor = width / view.width
    return Box(
        (box.cx - view.left) * factor,
        (box.cy - view.top) * factor,
        box.width * factor,
        box.height * factor,
    )
