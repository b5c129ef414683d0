"""Anchor boxes by k-means, with 1 - IoU as the distance, as in YOLO v2 (section 2)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Sizes = npt.NDArray[np.float64]

_MOST_ROUNDS = 100


def shape_iou(sizes: Sizes, others: Sizes) -> Sizes:
    """Return the overlap, (N, M), of boxes about the same centre, sizes (N, 2) and (M, 2)."""
    common = np.minimum(sizes[:, None], others[None]).prod(axis=2)
    union = sizes.prod(axis=1)[:, None] + others.prod(axis=1)[None] - common
    return np.asarray(common / union)


def find_anchors(sizes: Sizes, count: int, rng: np.random.Generator) -> Sizes:
    """Return `count` typical widths and heights, (count, 2), the smallest first.

    Args:
        sizes: (N, 2) widths and heights of boxes.
        count: how many.
        rng: for the first guess.

    Raises:
        ValueError: there are fewer different sizes than anchors wanted.
    """
    different = np.unique(sizes, axis=0)
    if len(different) < count:
        raise ValueError(
            f"{count} anchors need at least as many boxes of different sizes, not {len(different)}"
        )
    anchors = _spread(different, count, rng)
    for _ in range(_MOST_ROUNDS):
        nearest = shape_iou(sizes, anchors).argmax(axis=1)
        moved = np.array(
            [
                np.median(sizes[nearest == number], axis=0) if (nearest == number).any() else anchor
                for number, anchor in enumerate(anchors)
            ]
        )
        if np.allclose(moved, anchors):
            break
        anchors = moved
    return np.asarray(anchors[np.argsort(anchors.prod(axis=1))])


def _spread(sizes: Sizes, count: int, rng: np.random.Generator) -> Sizes:
    """Return the first guess: sizes that are each as unlike the others as chance has it."""
    chosen = [int(rng.integers(len(sizes)))]
    while len(chosen) < count:
        distance = 1 - shape_iou(sizes, sizes[chosen]).max(axis=1)
        distance[chosen] = 0
        chosen.append(int(rng.choice(len(sizes), p=distance / distance.sum())))
    return sizes[chosen].copy()


def mean_overlap(sizes: Sizes, anchors: Sizes) -> float:
    """Return the mean overlap of sizes with the anchor that fits each best."""
    return float(shape_iou(sizes, anchors).max(axis=1).mean())
