"""Runs of trackers over sequences, and what they are worth: the protocol of `fusion_cv.py`.

Each sequence is run from anchors every 100 frames, forwards from those in its first half and
backwards from the others (Kristan et al., "The Eighth Visual Object Tracking VOT2020 Challenge
Results"), and three times from its first frame with the box moved and scaled by up to 5 %. A
sequence's figure is the mean over its runs, so that a sequence that flips on a hair counts by how
often it flips.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from follower_vision.evaluation.datasets import load_dataset
from follower_vision.evaluation.one_pass import Sequence, start_box
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import TrackState

ANCHOR_FRAMES = 100
JITTERED_STARTS = 3
RATE_HZ = 30.0
PRECISE_PX = 20.0
EXPECTED_OVER = range(50, 301, 10)
"""Lengths in frames over which the expected overlap is averaged."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run begins.

    Attributes:
        kind: "anchor" or "jittered".
        frame: index of the first frame.
        step: 1 forwards, -1 backwards.
        box: to start from, pixels.
    """

    kind: str
    frame: int
    step: int
    box: Box


@dataclass(frozen=True, slots=True)
class Run:
    """One run's answer, scored; frames without the target and the first frame are not.

    Attributes:
        kind: the start's.
        frame: index of the first frame.
        step: 1 forwards, -1 backwards.
        overlaps: intersection over union in each scored frame.
        precise: whether the centre was within 20 px, likewise.
        believed: whether the tracker said that it sees the target, likewise.
        confidence: the tracker's own, likewise.
    """

    kind: str
    frame: int
    step: int
    overlaps: tuple[float, ...]
    precise: tuple[bool, ...]
    believed: tuple[bool, ...]
    confidence: tuple[float, ...]

    @property
    def figures(self) -> dict[str, float]:
        """Success, precision, area under the success curve, and "tracking" at an overlap of 0."""
        overlaps = np.array(self.overlaps)
        wrong = (overlaps == 0) & np.array(self.believed)
        return {
            "success": float(np.mean(overlaps > 0.5)),
            "precision": float(np.mean(self.precise)),
            "auc": float(np.mean(overlaps[:, None] > np.linspace(0, 1, 21))),
            "believed_at_0": float(np.mean(wrong)),
        }


def starts(sequence: Sequence) -> Iterator[Start]:
    """Where a sequence's runs begin; the same ones each time."""
    boxes, last = sequence.truth, len(sequence.truth) - 1
    for wanted in range(0, last, ANCHOR_FRAMES):
        step = 1 if wanted <= last / 2 else -1
        frame = next(
            (k for k in range(wanted, last + 1 if step > 0 else -1, step) if boxes[k]), None
        )
        box = None if frame is None else boxes[frame]
        if frame is not None and box is not None and _scored_after(sequence, frame, step):
            yield Start("anchor", frame, step, box)
    seed = zlib.crc32(sequence.name.encode())
    for number in range(JITTERED_STARTS):
        box = jittered(sequence.initial, np.random.default_rng((seed, number)))
        yield Start("jittered", 0, 1, box)


def jittered(box: Box, rng: np.random.Generator) -> Box:
    """Return a box moved and scaled at random, by up to 5 % of its sides."""
    right, down, grown = rng.uniform(-0.05, 0.05, 3)
    moved = box.moved_to(box.cx + right * box.width, box.cy + down * box.height)
    return moved.scaled(1 + grown)


def _scored_after(sequence: Sequence, frame: int, step: int) -> bool:
    after = sequence.truth[frame + 1 :] if step > 0 else sequence.truth[:frame]
    return any(box is not None for box in after)


def run(tracker: TargetTracker, images: list[Image], sequence: Sequence, start: Start) -> Run:
    """Let a tracker follow from one start to the sequence's end (or, backwards, beginning).

    Raises:
        DatasetError: nothing of the start's box lies inside the image.
    """
    stop = len(images) if start.step > 0 else -1
    first = images[start.frame]
    tracker.start(Frame(first, 0.0, 0), start_box(start.box, first))
    scored = []
    for number, index in enumerate(range(start.frame + start.step, stop, start.step), 1):
        track = tracker.step(Frame(images[index], number / RATE_HZ, number))
        true = sequence.truth[index]
        if true is not None:
            precise = track.box.distance(true) <= PRECISE_PX
            believed = track.state is TrackState.TRACKING
            scored.append((track.box.iou(true), precise, believed, track.confidence))
    overlaps, precise_, believed_, confidence = zip(*scored, strict=True)
    return Run(start.kind, start.frame, start.step, overlaps, precise_, believed_, confidence)


def run_all(folder: Path, make: Callable[[], TargetTracker]) -> tuple[str, list[Run]]:
    """All runs over one sequence; its frames are decoded once."""
    (sequence,), _ = load_dataset(folder)
    images = list(sequence.frames())
    return sequence.name, [run(make(), images, sequence, start) for start in starts(sequence)]


def sequence_figures(runs: list[Run]) -> dict[str, float]:
    """The mean of each figure over a sequence's runs."""
    figures = [one.figures for one in runs]
    return {name: float(np.mean([one[name] for one in figures])) for name in figures[0]}


def expected_overlap(runs: list[Run]) -> float:
    """The expected average overlap: over lengths, of runs that are at least that long."""
    means = [
        np.mean([np.mean(one.overlaps[:length]) for one in runs if len(one.overlaps) >= length])
        for length in EXPECTED_OVER
        if any(len(one.overlaps) >= length for one in runs)
    ]
    return float(np.mean(means)) if means else math.nan


def calibration_error(runs: list[Run], bins: int = 10) -> float:
    """The expected calibration error of the confidence as P(overlap > 0.5), over all frames."""
    told = np.concatenate([one.confidence for one in runs])
    right = np.concatenate([np.array(one.overlaps) > 0.5 for one in runs])
    place = np.minimum((told * bins).astype(int), bins - 1)
    parts = [(told[place == k], right[place == k]) for k in range(bins) if np.any(place == k)]
    return float(sum(len(c) * abs(np.mean(c) - np.mean(r)) for c, r in parts) / len(told))


def to_rows(runs: list[Run]) -> list[dict[str, object]]:
    """Runs as they are stored."""
    return [asdict(one) for one in runs]


def from_rows(rows: list[dict[str, Any]]) -> list[Run]:
    """Stored runs."""
    return [Run(**{name: _tuple(value) for name, value in row.items()}) for row in rows]


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
