"""Follows what might have been the target and was not chosen."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.fusion.candidates import corners_of
from follower_vision.geometry.box import Box, pairwise_iou

Floats = npt.NDArray[np.floating]

_MOST = 6
_OVERLAP = 0.3
_MISSED_S = 0.27
_KNOWN_S = 1.0
_VELOCITY_SHARE = 0.3
_PROBABILITY_TIME_S = 0.33


@dataclass(slots=True)
class _Distractor:
    """Something like the target that is tracked beside it.

    Attributes:
        box: where it is, or should be, in pixels.
        probability: mean of the P(IoU > 0.5) that it had lately.
        features: the motion tracker's features of it, (D,).
        deviations: the largest feature `deviation` that it had while the target was not seen.
        right_px_s: its velocity.
        down_px_s: the same downwards.
        seen_s: for how long it was seen.
        missed_s: for how long it was not seen.
    """

    box: Box
    probability: float
    features: Floats
    deviations: float
    right_px_s: float = 0.0
    down_px_s: float = 0.0
    seen_s: float = 0.0
    missed_s: float = 0.0


class Distractors:
    """Tracks of what looks like the target, each with the probability that it is the target.

    That probability, averaged over time, is the evidence for an identity swap: where two
    candidates are nearly equal in one frame, many frames tell them apart.
    """

    def __init__(self) -> None:
        self._tracks: list[_Distractor] = []
        self._interval_s = 0.0

    def predict(self, interval_s: float) -> None:
        """Go on by a time in seconds."""
        self._interval_s = interval_s
        for one in self._tracks:
            one.box = one.box.moved_to(
                one.box.cx + one.right_px_s * interval_s, one.box.cy + one.down_px_s * interval_s
            )

    def beside(self, corners: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return what is known of distractors at each of N boxes, four times (N,).

        Of the nearest one: the overlap (IoU), for how long it is known (a second or more is 1), and
        its probability. Of all that overlap: the largest feature `deviation` that they ever had;
        what is seen all the way from where the target cannot have been is not the target.
        """
        count = len(corners)
        if not self._tracks:
            nothing = np.zeros(count)
            return nothing, nothing, nothing, nothing
        table = pairwise_iou(corners, corners_of([one.box for one in self._tracks]))
        nearest = table.argmax(axis=1)
        best = table[np.arange(count), nearest]
        known = np.array([min(one.seen_s / _KNOWN_S, 1.0) for one in self._tracks])
        probability = np.array([one.probability for one in self._tracks])
        deviations = np.array([one.deviations for one in self._tracks])
        deviating = np.where(table >= _OVERLAP, deviations, 0.0).max(axis=1)
        there = best > 0
        return best, known[nearest] * there, probability[nearest] * there, deviating

    def likeness(self, features: Floats) -> Floats:
        """Return the largest cosine of N candidates' features, (N, D), with a distractor's."""
        if not self._tracks or not features.shape[1]:
            return np.zeros(len(features))
        known = np.stack([one.features for one in self._tracks])
        return np.asarray((features @ known.T).max(axis=1))

    def update(
        self,
        target: Box,
        boxes: list[Box],
        probabilities: Floats,
        features: Floats,
        deviations: Floats,
    ) -> None:
        """Take a frame's N candidates.

        Args:
            target: the target's box, pixels.
            boxes: the candidates', pixels, the best of each source first.
            probabilities: (N,) P(IoU > 0.5) of them.
            features: (N, D) the motion tracker's features of them.
            deviations: (N,) of them, 0 while the target is seen.
        """
        free = [k for k, box in enumerate(boxes) if box.iou(target) < _OVERLAP]
        for track in self._tracks:
            best = max(free, key=lambda k: boxes[k].iou(track.box), default=None)
            if best is not None and boxes[best].iou(track.box) >= _OVERLAP:
                taken = boxes[best]
                free = [k for k in free if boxes[k].iou(taken) < _OVERLAP]
                self._follow(track, taken, float(probabilities[best]), features[best])
                track.deviations = max(track.deviations, float(deviations[best]))
            else:
                track.missed_s += self._interval_s
        for k in free:
            if all(boxes[k].iou(track.box) < _OVERLAP for track in self._tracks):
                known = (float(probabilities[k]), features[k], float(deviations[k]))
                self._tracks.append(_Distractor(boxes[k], *known))
        kept = [
            one
            for one in self._tracks
            if one.missed_s <= _MISSED_S and one.box.iou(target) < 2 * _OVERLAP
        ]
        self._tracks = sorted(kept, key=lambda one: one.missed_s - one.seen_s)[:_MOST]

    def _follow(self, track: _Distractor, box: Box, probability: float, features: Floats) -> None:
        share = _VELOCITY_SHARE / self._interval_s
        track.right_px_s += share * (box.cx - track.box.cx)
        track.down_px_s += share * (box.cy - track.box.cy)
        rate = 1 - math.exp(-self._interval_s / _PROBABILITY_TIME_S)
        track.probability += rate * (probability - track.probability)
        if features.any():
            track.features = features
        track.box, track.missed_s = box, 0.0
        track.seen_s += self._interval_s
