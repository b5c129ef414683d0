"""Non-maximum suppression: of boxes that overlap, keep the one with the best score."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.floating]

_FEW = 40


def pairwise_iou(corners: Floats, others: Floats) -> Floats:
    """Return the intersection over union of every box with every other, (N, M).

    Both arguments hold left, top, right, bottom in their rows: (N, 4) and (M, 4).
    """
    first, second = corners[:, None, :], others[None, :, :]
    low = np.maximum(first[..., :2], second[..., :2])
    high = np.minimum(first[..., 2:], second[..., 2:])
    common = np.maximum(high - low, 0.0)
    sides, other_sides = first[..., 2:] - first[..., :2], second[..., 2:] - second[..., :2]
    # Written out: for two factors numpy's product takes several times as long.
    intersection = common[..., 0] * common[..., 1]
    areas, other_areas = sides[..., 0] * sides[..., 1], other_sides[..., 0] * other_sides[..., 1]
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
    if len(scores) <= _FEW:
        return _kept_of_few(corners.tolist(), scores.tolist(), overlap, most)
    waiting = np.argsort(-scores, kind="stable")
    kept: list[int] = []
    while waiting.size and len(kept) < most:
        best, rest = waiting[0], waiting[1:]
        kept.append(int(best))
        waiting = rest[pairwise_iou(corners[best : best + 1], corners[rest])[0] <= overlap]
    return kept


def _kept_of_few(
    corners: list[list[float]], scores: list[float], overlap: float, most: int
) -> list[int]:
    """`keep_best` without arrays, whose overhead is the larger part where there are few boxes."""
    kept: list[int] = []
    for index in sorted(range(len(scores)), key=lambda index: -scores[index]):
        if len(kept) == most:
            break
        if all(_iou(corners[index], corners[better]) <= overlap for better in kept):
            kept.append(index)
    return kept


def _iou(one: list[float], other: list[float]) -> float:
    """`pairwise_iou` of two boxes."""
    left, top, right, bottom = one
    low_x, low_y, high_x, high_y = other
    across = (right if right < high_x else high_x) - (left if left > low_x else low_x)
    down = (bottom if bottom < high_y else high_y) - (top if top > low_y else low_y)
    if across <= 0.0 or down <= 0.0:
        return 0.0
    common = across * down
    union = (right - left) * (bottom - top) + (high_x - low_x) * (high_y - low_y) - common
    return common / union if union > 0 else 0.0
