"""What a detector in flight is shown of a picture: the whole, or a zoomed crop about a target."""

from __future__ import annotations

import math

import numpy as np

from follower.training.detector.labelled import IGNORED, LabelledImage
from follower_vision.box import Box
from follower_vision.crop import crop
from follower_vision.detection.yolov2 import YoloV2Decoder
from follower_vision.frame import Image

_WHOLE_SHARE = 0.25
_ANYWHERE_SHARE = 0.05
_ZOOM = (2.4, 8.0)
_LEAST_CROP_PX = 64.0
_LEAST_INSIDE = 0.5
_TRACE_INSIDE = 0.1
_SMALLEST_PX = 10.0


def whole_view(picture: LabelledImage, side: int) -> LabelledImage:
    """Return the whole picture as the network sees it, `side` pixels square."""
    return cut_view(picture, _whole(picture), side)


def shown(picture: LabelledImage, side: int, rng: np.random.Generator) -> LabelledImage:
    """Return one view of a picture: the whole, a crop about one of its objects, or anywhere."""
    return cut_view(picture, _region(picture, rng), side)


def _whole(picture: LabelledImage) -> Box:
    height, width = picture.image.shape[:2]
    return Box(width / 2, height / 2, width, height)


def _region(picture: LabelledImage, rng: np.random.Generator) -> Box:
    whole, chance = _whole(picture), rng.random()
    if chance < _WHOLE_SHARE:
        return whole
    found = picture.boxes[picture.classes != IGNORED]
    if chance < _WHOLE_SHARE + _ANYWHERE_SHARE or not len(found):
        side = max(_LEAST_CROP_PX, whole.scale * float(rng.uniform(0.2, 0.7)))
        x, y = rng.uniform(0, 1, 2) * (whole.width, whole.height)
        return Box(float(x), float(y), side, side)
    left, top, right, bottom = found[int(rng.integers(len(found)))].tolist()
    zoom = float(np.exp(rng.uniform(*np.log(_ZOOM))))
    scale = math.sqrt((right - left) * (bottom - top))
    side = max(_LEAST_CROP_PX, zoom * scale, 1.15 * max(right - left, bottom - top))
    x, y = rng.uniform(-0.25, 0.25, 2) * side
    return Box((left + right) / 2 + float(x), (top + bottom) / 2 + float(y), side, side)


def cut_view(picture: LabelledImage, region: Box, side: int) -> LabelledImage:
    """Return a region of a picture as the network sees it, `side` pixels square.

    What the edge cuts is to be found if half of it is left; of less than a tenth nothing is said.
    """
    form = YoloV2Decoder.input_format
    view = form.view(region, side, side)
    image = crop(picture.image, view, side, side, [form.fill] * 3)
    scale = side / view.width
    corner = np.array([view.left, view.top] * 2, np.float32)
    moved = (picture.boxes - corner) * scale
    cut = np.clip(moved, *_limits(picture.image, view, scale)).astype(np.float32)
    inside = _areas(cut) / np.maximum(_areas(moved), 1e-9)
    large = (cut[:, 2:] - cut[:, :2]).max(axis=1, initial=0) >= _SMALLEST_PX
    classes = np.where((inside >= _LEAST_INSIDE) & large, picture.classes, IGNORED)
    kept = (inside >= _TRACE_INSIDE) & ((cut[:, 2:] - cut[:, :2]).min(axis=1, initial=9e9) > 0.5)
    return LabelledImage(image, cut[kept], classes[kept], picture.name)


def _limits(image: Image, view: Box, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners, in the view's pixels, of what the view shows of the image."""
    height, width = image.shape[:2]
    low = (np.maximum((view.left, view.top), 0) - (view.left, view.top)) * scale
    high = (np.minimum((view.right, view.bottom), (width, height)) - (view.left, view.top)) * scale
    return np.tile(low, 2).astype(np.float32), np.tile(high, 2).astype(np.float32)


def _areas(corners: np.ndarray) -> np.ndarray:
    return np.asarray((corners[:, 2:] - corners[:, :2]).prod(axis=1))
