"""Many starts a sequence, folds that are fixed, and the history of what was scored.

Each sequence is run from anchors every 100 frames, forwards from those in its first half and
backwards from the others (Kristan et al., "The Eighth Visual Object Tracking VOT2020 Challenge
Results"), and three times from its first frame with the box moved and scaled by up to 5 %.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from follower_vision.evaluation import one_pass
from follower_vision.evaluation.datasets import load_dataset
from follower_vision.evaluation.intervals import BOUNDS
from follower_vision.evaluation.multi_start import Run, Start, run
from follower_vision.geometry.box import Box
from follower_vision.trackers.target_tracker import TargetTracker

ANCHOR_FRAMES = 100
JITTERED_STARTS = 3
EXPECTED_OVER = range(50, 301, 10)
"""Lengths in frames over which the expected overlap is averaged."""
RESAMPLES = 200

Part = TypeVar("Part")


def starts(sequence: one_pass.Sequence) -> Iterator[Start]:
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


def _scored_after(sequence: one_pass.Sequence, frame: int, step: int) -> bool:
    after = sequence.truth[frame + 1 :] if step > 0 else sequence.truth[:frame]
    return any(box is not None for box in after)


def run_all(folder: Path, make: Callable[[], TargetTracker]) -> tuple[str, list[Run]]:
    """All runs over one sequence; its frames are decoded once."""
    (sequence,), _ = load_dataset(folder)
    images = list(sequence.frames())
    return sequence.name, [run(make(), images, sequence, start) for start in starts(sequence)]


def pooled_interval(
    by_sequence: Sequence[Sequence[Part]], measure: Callable[[list[Part]], float]
) -> tuple[float, float, float]:
    """Return a measure of all runs together, and its 95 % interval over sequences drawn anew."""
    rng = np.random.default_rng(0)
    values = []
    for _ in range(RESAMPLES):
        drawn = rng.integers(0, len(by_sequence), len(by_sequence))
        values.append(measure([one for k in drawn for one in by_sequence[k]]))
    low, high = np.nanpercentile(values, BOUNDS)
    return measure([one for runs in by_sequence for one in runs]), float(low), float(high)


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
