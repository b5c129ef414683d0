"""What single pieces of the vision side cost a frame of 640x480, beside a plain blur of it.

    python benchmarks/pieces.py

All pieces take turns on the same generated pictures, on one thread; the numbers are medians of the
processor's time; the ratio to OpenCV's Gaussian blur (9 pixels) holds on a busy machine too.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from follower_vision.drawing.video_writer import VideoWriter
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.longterm.search import TargetSearch
from follower_vision.models.store import ModelStore, default_folder
from follower_vision.selection import find_by_colour
from follower_vision.trackers.registry import make_tracker

WIDTH, HEIGHT, ROUNDS = 640, 480, 60
COLOUR, BOX = (30, 90, 255), Box(300.0, 200.0, 50.0, 40.0)


def scene(rng: np.random.Generator) -> Image:
    """Return a coloured patch before a smooth random ground."""
    coarse = rng.integers(60, 150, (HEIGHT // 16, WIDTH // 16, 3), np.uint8)
    image = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    x, y, width, height = map(round, BOX.xywh)
    image[y : y + height, x : x + width] = COLOUR
    image[y + height // 2 : y + height, x : x + width // 2] = 40
    return np.asarray(image, np.uint8)


def main() -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(1)
    pictures = [scene(rng) for _ in range(8)]
    search = TargetSearch()
    search.learn(pictures[0], BOX)
    re3 = make_tracker("re3", ModelStore(default_folder(os.environ)).file)
    re3.start(pictures[0], BOX)
    with tempfile.TemporaryDirectory() as folder, VideoWriter(Path(folder) / "a.mp4") as video:
        pieces: dict[str, Callable[[Image, int], object]] = {
            "Gaussian blur": lambda image, _: cv2.GaussianBlur(image, (9, 9), 0),
            "a colour found": lambda image, _: find_by_colour(image, COLOUR),
            "a lost target looked for": lambda image, _: search.everywhere(image, BOX, 150),
            "Re3": lambda image, _: re3.update(image),
            "video written": lambda image, number: video.write(image, number / 30),
        }
        took: dict[str, list[float]] = {name: [] for name in pieces}
        for number in range(ROUNDS):
            for name, piece in pieces.items():
                begin_s = time.process_time()
                piece(pictures[number % len(pictures)], number)
                took[name].append(time.process_time() - begin_s)
    blur_s = float(np.median(took["Gaussian blur"]))
    for name, seconds in took.items():
        median_s = float(np.median(seconds))
        print(f"{name:26} {1e3 * median_s:6.2f} ms {median_s / blur_s:6.1f} blurs")


if __name__ == "__main__":
    main()
