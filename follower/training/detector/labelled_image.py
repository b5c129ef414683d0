"""One picture with what is to be found in it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from follower_control.common.strict_config import SettingsError
from follower_vision.detection.detection import Candidates, NetworkLayout
from follower_vision.detection.families import YOLOV2_STRIDE, YoloV2Decoder
from follower_vision.geometry.box import keep_best
from follower_vision.images.frame import Image
from follower_vision.onnx_network import Tensor

Floats = npt.NDArray[np.float32]
Numbers = npt.NDArray[np.intp]

_LEAST_SCORE = 0.01
_OVERLAP = 0.45
_MOST = 100
_BLUR_LEAST_PX = 1.5
_BLUR_MOST_PX = 31
IGNORED = -1
"""The class of what is neither to be found nor counted as a false alarm: too hidden, say."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """A picture and the boxes in it.

    Attributes:
        image: (H, W, 3) uint8 BGR.
        boxes: (N, 4) left, top, right, bottom in pixels.
        classes: (N,) class numbers, or `IGNORED`.
    """

    image: Image
    boxes: Floats
    classes: Numbers


def read_picture(path: Path, flags: int = cv2.IMREAD_COLOR) -> Image:
    """Read a picture as uint8, (H, W, 3) BGR unless OpenCV's flags for reading say otherwise.

    Raises:
        SettingsError: the file is missing or is no picture.
    """
    image = cv2.imread(str(path), flags)
    if image is None:
        raise SettingsError(f"{path}: this is no picture, or it is broken")
    return np.asarray(image, np.uint8)


class TrainingImages(Protocol):
    """Where a training's pictures come from."""

    @property
    def class_names(self) -> tuple[str, ...]:
        """The names of the classes, by their numbers."""
        ...

    def training(self, side: int, seed: int) -> Iterator[LabelledImage]:
        """Return an endless stream of square pictures of `side` pixels; one seed, one stream."""
        ...

    def held_out(self, side: int, count: int) -> list[LabelledImage]:
        """Return at most `count` pictures that no training sees, always the same."""
        ...


class AnswerReader:
    """Turns a region layer's input into boxes, overlapping ones removed, for measuring.

    Args:
        anchors: (A, 2) in cells.
        classes: how many.
        side_px: of the square input.
    """

    def __init__(self, anchors: np.ndarray, classes: int, side_px: int) -> None:
        cells, depth = side_px // YOLOV2_STRIDE, len(anchors) * (5 + classes)
        pairs = tuple((float(width), float(height)) for width, height in anchors)
        shape = (1, depth, cells, cells)
        self._decoder = YoloV2Decoder(NetworkLayout(side_px, side_px, (("region", shape),), pairs))

    def read(self, answer: Tensor, least_score: float = _LEAST_SCORE) -> Candidates:
        """Return the boxes in pixels of the input, of an answer (A * (5 + classes), H, W)."""
        found = self._decoder.decode([answer[None]], least_score).valid()
        kept: list[int] = []
        for number in np.unique(found.classes).tolist():
            mine = np.flatnonzero(found.classes == number)
            best = keep_best(found.corners[mine], found.scores[mine], _OVERLAP, _MOST)
            kept += mine[best].tolist()
        return Candidates(found.corners[kept], found.scores[kept], found.classes[kept])


def distorted(picture: LabelledImage, rng: np.random.Generator) -> LabelledImage:
    """Return a picture of the same shape, other light, colours and noise; half are mirrored."""
    changed = replace(picture, image=_noisy(_lit(picture.image, rng), rng))
    return changed if rng.random() < 0.5 else mirrored(changed)


def mirrored(picture: LabelledImage) -> LabelledImage:
    """Return a picture, boxes in pixels, with left and right exchanged."""
    width = picture.image.shape[1]
    boxes = picture.boxes[:, [2, 1, 0, 3]] * np.array([-1, 1, -1, 1]) + np.array([width, 0] * 2)
    image = np.ascontiguousarray(picture.image[:, ::-1])
    return LabelledImage(image, boxes.astype(np.float32), picture.classes)


def _lit(image: Image, rng: np.random.Generator) -> Image:
    """Change gain, contrast, colour balance and gamma by one table a channel."""
    values = np.arange(256, dtype=np.float32) / 255
    gain, contrast, gamma = np.exp(rng.normal(0, (0.14, 0.1, 0.12)))
    balance = np.exp(rng.normal(0, 0.05, 3))
    tables = [
        np.clip((gain * part * values**gamma - 0.45) * contrast + 0.45, 0, 1) * 255
        for part in balance
    ]
    table = np.stack(tables, axis=1).astype(np.uint8)[None]
    return np.asarray(cv2.LUT(image, table), np.uint8)


def _noisy(image: Image, rng: np.random.Generator) -> Image:
    if rng.random() < 0.2:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.4, 1.6))), np.uint8)
    if rng.random() < 0.5:
        return image
    field = np.empty(image.shape, np.int16)
    cv2.setRNGSeed(int(rng.integers(1 << 31)))
    cv2.randn(field, np.zeros(3), np.full(3, rng.uniform(1, 7)))
    return np.asarray(cv2.add(image, field, dtype=cv2.CV_8U), np.uint8)


def motion_blurred(image: Image, way: npt.NDArray[np.float64]) -> Image:
    """Smear a picture along the way (2,), right and down in its pixels, that it moved."""
    length = float(np.hypot(*way))
    if length < _BLUR_LEAST_PX:
        return image
    way = way * min(1.0, _BLUR_MOST_PX / length)
    side = 2 * int(np.ceil(np.abs(way).max() / 2)) + 1
    kernel = np.zeros((side, side), np.float32)
    middle = np.array([side // 2, side // 2])
    first, last = (np.round(16 * (middle + sign * way / 2)).astype(int) for sign in (-1, 1))
    cv2.line(kernel, first.tolist(), last.tolist(), 1.0, 1, cv2.LINE_AA, 4)
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), dtype=np.uint8)
