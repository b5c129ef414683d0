"""One-pass evaluation: load a sequence, run a motion tracker over it, keep boxes and times."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from follower_vision.box import Box
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.frame import Image
from follower_vision.metrics import OpeScore, ope_score
from follower_vision.motion import MotionTracker

_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp"})


@dataclass(frozen=True, slots=True)
class Sequence:
    """Images in order and the target's true box in each.

    Attributes:
        name: for tables.
        images: files, one a frame.
        truth: one a frame; None where the target is absent. The first is a box.
        attributes: by name, e.g. "occlusion", the frames in which each holds.
        rate_hz: frames a second, None if nobody said.
    """

    name: str
    images: tuple[Path, ...]
    truth: tuple[Box | None, ...]
    attributes: Mapping[str, tuple[bool, ...]] = field(default_factory=dict)
    rate_hz: float | None = None

    def __post_init__(self) -> None:
        if len(self.images) != len(self.truth):
            raise ValueError(f"{self.name}: {len(self.images)} images, {len(self.truth)} boxes")
        if not self.truth or self.truth[0] is None:
            raise ValueError(f"{self.name}: the first frame has no box")
        if any(len(flags) != len(self.truth) for flags in self.attributes.values()):
            raise ValueError(f"{self.name}: an attribute needs a flag for each frame")

    @property
    def initial(self) -> Box:
        """The true box in the first frame."""
        first = self.truth[0]
        if first is None:
            raise ValueError(f"{self.name}: the first frame has no box")
        return first

    def frames(self) -> Iterator[Image]:
        """Read the images one after the other.

        Raises:
            OSError: one cannot be read.
        """
        for path in self.images:
            yield read_image(path)


@dataclass(frozen=True, slots=True)
class OpeRun:
    """What a tracker answered over one sequence.

    Attributes:
        boxes: one a frame, the initial one first.
        confidences: one a frame; 1 for the initial box.
        update_s: time of each update in seconds, one fewer than boxes.
        score: of the boxes against the truth.
    """

    boxes: tuple[Box, ...]
    confidences: tuple[float, ...]
    update_s: tuple[float, ...]
    score: OpeScore


def load_sequence(folder: Path) -> Sequence:
    """Load a folder with `img/` and `groundtruth.txt`, a box x, y, w, h a line.

    Numbers stand apart by commas, spaces or tabs; w or h of 0 (or NaN) means an absent target.

    Raises:
        OSError: there is no such file.
        ValueError: a line is no box, or images and boxes do not match.
    """
    images = sorted(path for path in (folder / "img").iterdir() if path.suffix.lower() in _SUFFIXES)
    lines = (folder / "groundtruth.txt").read_text(encoding="utf-8").splitlines()
    truth = tuple(parse_box(line) for line in lines if line.strip())
    return Sequence(folder.name, tuple(images), truth)


def parse_box(line: str) -> Box | None:
    """Read x, y, w, h; None if the line says that the target is absent.

    Raises:
        ValueError: the line does not hold four numbers.
    """
    numbers = [float(word) for word in re.split(r"[,\s]+", line.strip())]
    if len(numbers) != 4:
        raise ValueError(f"a box is x, y, w, h, not {line.strip()!r}")
    if not np.all(np.isfinite(numbers)) or min(numbers[2:]) <= 0:
        return None
    return Box.from_xywh(*numbers)


def read_image(path: Path) -> Image:
    """Read an image file as (H, W, 3) uint8 BGR.

    Raises:
        OSError: it cannot be read.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise OSError(f"cannot read the image {path}")
    return np.asarray(image, np.uint8)


def run_ope(
    tracker: MotionTracker,
    sequence: Sequence,
    initial: Box | None = None,
    clock: Clock | None = None,
) -> OpeRun:
    """Start a tracker on the first frame and let it run to the end without help.

    Args:
        tracker: is started anew.
        sequence: what to run over.
        initial: box to start from instead of the true one, e.g. a jittered one.
        clock: times the updates; the computer's by default.
    """
    clock = clock or MonotonicClock()
    box = initial or sequence.initial
    boxes, confidences, update_s = [box], [1.0], []
    frames = sequence.frames()
    tracker.start(next(frames), box)
    for image in frames:
        begin = clock.now()
        estimate = tracker.update(image)
        update_s.append(clock.now() - begin)
        boxes.append(estimate.box)
        confidences.append(estimate.confidence)
    score = ope_score(boxes, sequence.truth)
    return OpeRun(tuple(boxes), tuple(confidences), tuple(update_s), score)


def jittered(box: Box, rng: np.random.Generator, share: float = 0.05) -> Box:
    """Return a box moved and scaled at random, by up to `share` of its sides."""
    right, down, grown = rng.uniform(-share, share, 3)
    moved = box.moved_to(box.cx + right * box.width, box.cy + down * box.height)
    return moved.scaled(1 + grown)
