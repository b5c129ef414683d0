"""Non-maximum suppression: of boxes that overlap, keep the one with the best score."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.floating]


def pairwise_iou(corners: Floats, others: Floats) -> Floats:
    """Return the intersection over union of every box with every other, (N, M).

    Both arguments hold left, top, right, bottom in their rows: (N, 4) and (M, 4).
    """
    first, second = corners[:, None, :], others[None, :, :]
    low = np.maximum(first[..., :2], second[..., :2])
    high = np.minimum(first[..., 2:], second[..., 2:])
    intersection = np.prod(np.maximum(high - low, 0.0), axis=-1)
    areas = np.prod(first[..., 2:] - first[..., :2], axis=-1)
    other_areas = np.prod(second[..., 2:] - second[..., :2], axis=-1)
    union = areas + other_areas - intersection
    return np.asarray(np.divide(intersection, union, out=np.zeros_like(union), where=union > 0))


def keep_best(corners: Floats, scores: Floats, overlap: float, most: int) -> list[int]:
    """Return the indices of at most `most` boxes, best first, no two overlapping too much.

    Args:
        corners: (N, 4) left, top, right, bottom.
        scores: (N,).
        overlap: largest intersection over union that two kept boxes may have.
        most: how many to keep.
    """
    waiting = np.argsort(-scores, kind="stable")
    kept: list[int] = []
    while waiting.size and len(kept) < most:
        best, rest = waiting[0], waiting[1:]
        kept.append(int(best))
        waiting = rest[pairwise_iou(corners[best : best + 1], corners[rest])[0] <= overlap]
    return kept
