"""Changes of light, colour, sharpness and side that keep a picture's labels true."""

from __future__ import annotations

import cv2
import numpy as np

from follower.training.detector.labelled import LabelledImage
from follower_vision.frame import Image


def distorted(picture: LabelledImage, rng: np.random.Generator) -> LabelledImage:
    """Return a picture with other light and colours, noise, and in half of the cases mirrored."""
    image = _noisy(_lit(picture.image, rng), rng)
    changed = LabelledImage(image, picture.boxes, picture.classes, picture.name)
    return changed if rng.random() < 0.5 else mirrored(changed)


def mirrored(picture: LabelledImage) -> LabelledImage:
    """Return a picture with left and right exchanged."""
    width = picture.image.shape[1]
    boxes = picture.boxes[:, [2, 1, 0, 3]] * np.array([-1, 1, -1, 1]) + np.array([width, 0] * 2)
    image = np.ascontiguousarray(picture.image[:, ::-1])
    return LabelledImage(image, boxes.astype(np.float32), picture.classes, picture.name)


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
