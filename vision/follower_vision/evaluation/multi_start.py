"""Runs of trackers over sequences from any frame, forwards or backwards, and their figures.

A sequence's figure is the mean over its runs, so that a sequence that flips on a hair counts by how
often it flips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from follower_vision.evaluation.one_pass import Sequence, start_box
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import TrackState

RATE_HZ = 30.0
PRECISE_PX = 20.0


@dataclass(frozen=True, slots=True)
class Start:
    """Where a run begins.

    Attributes:
        kind: why it begins there, in a word.
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


def sequence_figures(runs: list[Run]) -> dict[str, float]:
    """The mean of each figure over a sequence's runs."""
    figures = [one.figures for one in runs]
    return {name: float(np.mean([one[name] for one in figures])) for name in figures[0]}
