"""Whether a tracker says what is true: its states held against the truth."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from follower_vision.box import Box
from follower_vision.metrics import SUCCESS_IOU
from follower_vision.track import TrackState

SOON_S = 0.5
_Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Honesty:
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


def honesty(
    boxes: Sequence[Box | None],
    states: Sequence[TrackState],
    truth: Sequence[Box | None],
    interval_s: float,
) -> Honesty:
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
    return Honesty(
        _share(tracking[1:] & (overlap[1:] == 0), scored) or 0.0,
        _share(tracking[1:], ~scored),
        _share(~tracking[1:], right[1:]),
        tuple(frames * interval_s for frames in returns),
        tuple(frames * interval_s for frames in losses),
    )


def mean_honesty(parts: Sequence[Honesty]) -> Honesty:
    """Average the shares, each part with the same weight, and gather the times.

    Raises:
        ValueError: there is none.
    """
    if not parts:
        raise ValueError("there is no honesty to average")
    return Honesty(
        float(np.mean([part.false_tracking for part in parts])),
        _mean([part.absent_tracking for part in parts]),
        _mean([part.doubted for part in parts]),
        tuple(time_s for part in parts for time_s in part.returns_s),
        tuple(time_s for part in parts for time_s in part.losses_s),
    )


def median_s(times_s: Sequence[float]) -> float | None:
    """Return the median, infinite if half were never found again, None if there is no time."""
    return statistics.median(times_s) if times_s else None


def share_soon(times_s: Sequence[float], limit_s: float = SOON_S) -> float | None:
    """Return the share of times under `limit_s`, None if there is none."""
    return float(np.mean([time_s < limit_s for time_s in times_s])) if times_s else None


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
