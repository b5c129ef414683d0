"""Crowded grounds: many objects lying on a photograph."""

from __future__ import annotations

import cv2
import numpy as np

from follower.training.scenes.pictures import Pictures
from follower_vision.frame import Image

_SIDE_PX = 700
_MARGIN_PX = 50


def collage(rng: np.random.Generator, stock: Pictures) -> Image:
    """Return a ground (700, 700, 3) with 20 to 120 objects of the stock on it."""
    canvas = np.asarray(cv2.resize(stock.any_ground(rng), (_SIDE_PX, _SIDE_PX)), dtype=np.uint8)
    for _ in range(int(rng.integers(20, 120))):
        item = stock.any_object(rng)
        zoom, turn = np.exp(rng.uniform(-1.2, 0.5)), rng.uniform(0, 2 * np.pi)
        place = np.eye(3)
        place[0, :2] = zoom * np.cos(turn), -zoom * np.sin(turn)
        place[1, :2] = zoom * np.sin(turn), zoom * np.cos(turn)
        place[:2, 2] = rng.uniform(-_MARGIN_PX, _SIDE_PX, 2)
        canvas, _ = item.draw(canvas, place)
    return canvas
