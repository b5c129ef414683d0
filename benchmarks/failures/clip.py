"""A short video with the target's boxes, from a folder or generated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image

RATE_HZ = 30.0
SYNTHETIC = ("synthetic_walk", "synthetic_run", "synthetic_small")
_WIDTH, _HEIGHT, _FRAMES = 480, 270, 100


@dataclass(frozen=True)
class Clip:
    """A video that is made frame by frame when asked.

    Attributes:
        name: of the sequence.
        truth: the target's box in each frame, None where it is out of sight.
        picture: gives the image of a frame's number, (H, W, 3) uint8 BGR, never the same array.
        size: (width, height) in pixels.
        rate_hz: frames a second.
        hidden: numbers of the frames in which the target is there but wholly covered.
        edge: numbers of the frames without truth in which a small part of the target is in sight.
    """

    name: str
    truth: Sequence[Box | None]
    picture: Callable[[int], Image]
    size: tuple[int, int]
    rate_hz: float = RATE_HZ
    hidden: frozenset[int] = frozenset()
    edge: frozenset[int] = frozenset()

    def __len__(self) -> int:
        return len(self.truth)

    @property
    def start(self) -> Box:
        """The target's box in the first frame.

        Raises:
            ValueError: it is out of sight there.
        """
        if self.truth[0] is None:
            raise ValueError(f"{self.name}: the target is out of sight in the first frame")
        return self.truth[0]

    def frame(self, number: int) -> Frame:
        """Return a frame with its time."""
        return Frame(self.picture(number), number / self.rate_hz, number)

    def returns(self) -> list[int]:
        """Return the frames in which the target comes into sight again."""
        unseen = [box is None or k in self.hidden for k, box in enumerate(self.truth)]
        return [k for k in range(1, len(unseen)) if unseen[k - 1] and not unseen[k]]


def read_clip(folder: Path) -> Clip:
    """Read a sequence of `img/*.jpg` and `groundtruth.txt` (x, y, width, height a line)."""
    lines = (folder / "groundtruth.txt").read_text().split()
    values = [[float(value) for value in line.split(",")] for line in lines]
    truth = [Box.from_xywh(*row) if row[2] > 0 and row[3] > 0 else None for row in values]
    paths = sorted((folder / "img").iterdir())[: len(truth)]

    def picture(number: int) -> Image:
        return np.asarray(cv2.imread(str(paths[number])), np.uint8)

    height, width = picture(0).shape[:2]
    return Clip(folder.name, truth[: len(paths)], picture, (width, height))


def synthetic_clip(name: str) -> Clip:
    """Return a textured patch that moves over a textured ground; see `SYNTHETIC`."""
    seed = SYNTHETIC.index(name)
    side, speed = ((40, 1.0), (48, 3.5), (14, 1.0))[seed]
    rng = np.random.default_rng(seed)
    ground = _texture(rng, _WIDTH, _HEIGHT, 5)
    patch = _texture(rng, side, side * 2, 3)
    phases = np.arange(_FRAMES) * 0.02 * speed
    across = _WIDTH / 2 + 0.3 * _WIDTH * np.sin(phases)
    down = _HEIGHT / 2 + 0.2 * _HEIGHT * np.sin(1.3 * phases)
    truth = [Box(round(x), round(y), side, 2 * side) for x, y in zip(across, down, strict=True)]

    def picture(number: int) -> Image:
        image, box = ground.copy(), truth[number]
        top, left = int(box.top), int(box.left)
        image[top : top + 2 * side, left : left + side] = patch
        return image

    return Clip(name, truth, picture, (_WIDTH, _HEIGHT))


def _texture(rng: np.random.Generator, width: int, height: int, grain: int) -> Image:
    noise = rng.integers(30, 226, (-(-height // grain), -(-width // grain), 3), dtype=np.uint8)
    return np.asarray(cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)
