"""The measures of one-pass evaluation: overlap, distance, and how true a tracker's states are.

Success, precision and the starts of the robustness tests after Wu, Lim and Yang, "Object Tracking
Benchmark" (PAMI 2015): the tracker starts from the first frame's true box and is never helped
again. The first frame is not scored, nor are frames in which the target is absent. Normalised
precision after Müller et al., "TrackingNet" (ECCV 2018).
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from follower_vision.geometry.box import Box
from follower_vision.trackers.track import TrackState

SUCCESS_IOU = 0.5
PRECISION_PX = 20.0
SUCCESS_AT = np.linspace(0, 1, 21)
PRECISION_AT = np.arange(51.0)
NORMALISED_AT = np.linspace(0, 0.5, 51)
SOON_S = 0.5
_Flags = NDArray[np.bool_]
_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OpeScore:
    """How well boxes agree with the truth over one sequence.

    Attributes:
        success: share of scored frames whose intersection over union exceeds 0.5.
        precision: share of scored frames whose centre is within 20 px of the true one.
        auc: mean, over the thresholds 0, 0.05 to 1, of the share of frames that exceed them.
        frames: number of scored frames.
    """

    success: float
    precision: float
    auc: float
    frames: int


def ope_score(boxes: Sequence[Box | None], truth: Sequence[Box | None]) -> OpeScore:
    """Score one sequence.

    Args:
        boxes: the tracker's, one a frame, the initial one first, in pixels; None is a miss.
        truth: one a frame, in pixels; None where the target is absent.

    Raises:
        ValueError: the lengths differ, or no frame can be scored.
    """
    pairs = _scored(boxes, truth)
    iou, distance = _overlaps_and_distances(pairs)
    return OpeScore(
        success=float(np.mean(iou > SUCCESS_IOU)),
        precision=float(np.mean(distance <= PRECISION_PX)),
        auc=float(np.mean(iou[:, None] > SUCCESS_AT)),
        frames=len(pairs),
    )


def _scored(
    boxes: Sequence[Box | None], truth: Sequence[Box | None]
) -> list[tuple[Box | None, Box]]:
    """Return the tracker's and the true box of every frame that is scored."""
    if len(boxes) != len(truth):
        raise ValueError(f"{len(boxes)} boxes for {len(truth)} frames of truth")
    later = zip(boxes[1:], truth[1:], strict=True)
    pairs = [(box, true) for box, true in later if true is not None]
    if not pairs:
        raise ValueError("no frame after the first one has a true box")
    return pairs


def _overlaps_and_distances(pairs: Sequence[tuple[Box | None, Box]]) -> tuple[_Floats, _Floats]:
    """Return intersection over union, and the distance of the centres in pixels."""
    iou = np.array([box.iou(true) if box else 0.0 for box, true in pairs])
    return iou, np.array([box.distance(true) if box else math.inf for box, true in pairs])


def mean_score(scores: Sequence[OpeScore]) -> OpeScore:
    """Average over sequences, each with the same weight; the frames are summed.

    Raises:
        ValueError: there is none.
    """
    return OpeScore(
        success=float(np.mean([score.success for score in scores])),
        precision=float(np.mean([score.precision for score in scores])),
        auc=float(np.mean([score.auc for score in scores])),
        frames=sum(score.frames for score in scores),
    )


@dataclass(frozen=True, slots=True)
class OpeCurves:
    """Shares of the scored frames, one value a threshold.

    Attributes:
        success: intersection over union above SUCCESS_AT.
        precision: centre within PRECISION_AT pixels.
        normalised: centre within NORMALISED_AT of the true box's sides.
    """

    success: tuple[float, ...]
    precision: tuple[float, ...]
    normalised: tuple[float, ...]

    @property
    def normalised_precision(self) -> float:
        """The mean of the normalised curve: the area under it over its width."""
        return float(np.mean(self.normalised))


def ope_curves(boxes: Sequence[Box | None], truth: Sequence[Box | None]) -> OpeCurves:
    """Score one sequence as `ope_score` does, at all thresholds.

    Raises:
        ValueError: the lengths differ, or no frame can be scored.
    """
    pairs = _scored(boxes, truth)
    iou, off = _overlaps_and_distances(pairs)
    relative = np.array([_relative(box, true) for box, true in pairs])
    return OpeCurves(
        tuple(np.mean(iou[:, None] > SUCCESS_AT, axis=0).tolist()),
        tuple(np.mean(off[:, None] <= PRECISION_AT, axis=0).tolist()),
        tuple(np.mean(relative[:, None] <= NORMALISED_AT, axis=0).tolist()),
    )


def _relative(box: Box | None, true: Box) -> float:
    if box is None:
        return math.inf
    return math.hypot((box.cx - true.cx) / true.width, (box.cy - true.cy) / true.height)


def mean_curves(curves: Sequence[OpeCurves]) -> OpeCurves:
    """Average curves, each with the same weight.

    Raises:
        ValueError: there is none.
    """
    means = [
        tuple(np.mean([getattr(c, name) for c in curves], axis=0).tolist())
        for name in ("success", "precision", "normalised")
    ]
    return OpeCurves(*means)


def temporal_starts(truth: Sequence[Box | None], number: int) -> list[int]:
    """Return up to `number` frames, evenly apart, to start from: each has a box and a successor."""
    number = min(number, len(truth))
    wanted = [len(truth) * index // number for index in range(number)]
    present = [k for k, box in enumerate(truth) if box and any(truth[k + 1 :])]
    later = (next((k for k in present if k >= frame), None) for frame in wanted)
    return sorted({frame for frame in later if frame is not None})


def spatial_starts(box: Box) -> list[Box]:
    """Return the twelve disturbed start boxes: eight shifts by a tenth, four scales."""
    steps = [(x, y) for x in (-0.1, 0, 0.1) for y in (-0.1, 0, 0.1) if (x, y) != (0, 0)]
    shifts = [box.moved_to(box.cx + x * box.width, box.cy + y * box.height) for x, y in steps]
    return [*shifts, *(box.scaled(factor) for factor in (0.8, 0.9, 1.1, 1.2))]


@dataclass(frozen=True, slots=True)
class StateAccuracy:
    """How far a tracker's states can be believed. A box is right above an overlap of 0.5.

    Attributes:
        false_tracking: of the scored frames, the share called TRACKING at an overlap of 0.
        absent_tracking: of the frames without the target, the share called TRACKING; None where
            the target is always there.
        doubted: of the right boxes, the share not called TRACKING; None without a right box.
        returns_s: for each time that the target came back, how long until a right box was called
            TRACKING; infinite if it left again, or the sequence ended, before that.
        losses_s: the same for each time that the tracker called the target LOST, or its box left
            the target, while the target was there and the tracker had been right. A loss that
            ends with the target's own leaving is not counted.
    """

    false_tracking: float
    absent_tracking: float | None
    doubted: float | None
    returns_s: tuple[float, ...]
    losses_s: tuple[float, ...]


def state_accuracy(
    boxes: Sequence[Box | None],
    states: Sequence[TrackState],
    truth: Sequence[Box | None],
    interval_s: float,
) -> StateAccuracy:
    """Hold states against the truth. The first frame is given and not scored.

    Args:
        boxes: the tracker's, one a frame.
        states: the tracker's, one a frame.
        truth: one a frame; None where the target is absent.
        interval_s: time between frames.

    Raises:
        ValueError: the lengths differ.
    """
    rows = list(zip(boxes, states, truth, strict=True))
    overlap = np.array([box.iou(true) if box and true else 0.0 for box, _, true in rows])
    tracking = np.array([state is TrackState.TRACKING for _, state, _ in rows])
    lost = np.array([state is TrackState.LOST for _, state, _ in rows])
    present = np.array([true is not None for _, _, true in rows])
    right = overlap > SUCCESS_IOU
    found = right & tracking
    stays = _stays(present)
    returns = [_first(found, start, end) - start for start, end in stays if start > 0]
    losses = [
        frames
        for stay in stays
        for frames in _losses(found, lost | (overlap == 0), stay, len(rows))
    ]
    scored = present[1:]
    return StateAccuracy(
        _share(tracking[1:] & (overlap[1:] == 0), scored) or 0.0,
        _share(tracking[1:], ~scored),
        _share(~tracking[1:], right[1:]),
        tuple(frames * interval_s for frames in returns),
        tuple(frames * interval_s for frames in losses),
    )


def mean_state_accuracy(parts: Sequence[StateAccuracy]) -> StateAccuracy:
    """Average the shares, each part with the same weight, and gather the times.

    Raises:
        ValueError: there is none.
    """
    return StateAccuracy(
        float(np.mean([part.false_tracking for part in parts])),
        _mean([part.absent_tracking for part in parts]),
        _mean([part.doubted for part in parts]),
        tuple(time_s for part in parts for time_s in part.returns_s),
        tuple(time_s for part in parts for time_s in part.losses_s),
    )


def median_s(times_s: Sequence[float]) -> float | None:
    """Return the median, infinite if half were never found again, None if there is no time."""
    return statistics.median(times_s) if times_s else None


def share_soon(times_s: Sequence[float]) -> float | None:
    """Return the share of times under `SOON_S`, None if there is none."""
    return float(np.mean([time_s < SOON_S for time_s in times_s])) if times_s else None


def _stays(present: _Flags) -> list[tuple[int, int]]:
    """Return the spans [start, end) of frames with the target."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], present, [False]]).astype(int)))
    return [(int(start), int(end)) for start, end in edges.reshape(-1, 2)]


def _first(flags: _Flags, start: int, end: int) -> float:
    """Return the first frame in [start, end) whose flag is set, infinity if there is none."""
    hits = np.flatnonzero(flags[start:end])
    return float(start + hits[0]) if len(hits) else math.inf


def _losses(found: _Flags, gone: _Flags, stay: tuple[int, int], frames: int) -> list[float]:
    """Return how many frames each loss within a stay lasted."""
    lasted: list[float] = []
    start, end = stay
    begin = start if start == 0 else _first(found, start, end)
    while begin < end:
        loss = _first(gone, int(begin) + 1, end)
        if loss >= end:
            break
        begin = _first(found, int(loss), end)
        if begin < end or end == frames:
            lasted.append(begin - loss)
    return lasted


def _share(flags: _Flags, of: _Flags) -> float | None:
    return float(np.mean(flags[of])) if of.any() else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
