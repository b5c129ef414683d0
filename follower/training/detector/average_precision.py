"""Mean average precision at an overlap of one half."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from follower.training.detector.labelled_image import IGNORED, LabelledImage, Numbers
from follower_vision.detection.detection import Candidates
from follower_vision.geometry.box import pairwise_iou

MATCH_IOU = 0.5


@dataclass(frozen=True, slots=True)
class Precision:
    """How well a detector does on held-out pictures.

    Attributes:
        mean: of the classes that occur, 0 to 1; None if none does.
        of_class: average precision of each class, None where the class does not occur.
        objects: how many objects each class has.
    """

    mean: float | None
    of_class: tuple[float | None, ...]
    objects: tuple[int, ...]


def mean_average_precision(
    found: Sequence[Candidates], truth: Sequence[LabelledImage], classes: int
) -> Precision:
    """Compare detections with the truth as PASCAL VOC (2010 and later) does.

    Args:
        found: of each picture, after overlapping boxes were removed.
        truth: the pictures; a detection on an ignored box counts neither way.
        classes: how many there are.
    """
    each = [_of_class(found, truth, number) for number in range(classes)]
    measured = [value for value, _ in each if value is not None]
    mean = float(np.mean(measured)) if measured else None
    return Precision(mean, tuple(v for v, _ in each), tuple(count for _, count in each))


def _of_class(
    found: Sequence[Candidates], truth: Sequence[LabelledImage], number: int
) -> tuple[float | None, int]:
    objects = sum(int((one.classes == number).sum()) for one in truth)
    if not objects:
        return None, 0
    pairs = zip(found, truth, strict=True)
    judged = [one for pair in pairs for one in _judged(*pair, number)]
    judged.sort(key=lambda one: -one[0])
    return average_precision(np.array([hit for _, hit in judged], bool), objects), objects


def _judged(
    candidates: Candidates, picture: LabelledImage, number: int
) -> list[tuple[float, bool]]:
    """Return score and right or wrong of each detection that counts, in one picture."""
    mine = np.flatnonzero(candidates.classes == number)
    mine = mine[np.argsort(-candidates.scores[mine], kind="stable")]
    wanted = picture.boxes[picture.classes == number]
    ignored = picture.boxes[picture.classes == IGNORED]
    free = np.ones(len(wanted), bool)
    judged = []
    for place in mine.tolist():
        corners, score = candidates.corners[place : place + 1], float(candidates.scores[place])
        overlaps = pairwise_iou(corners, wanted)[0] * free
        if overlaps.max(initial=0) >= MATCH_IOU:
            free[overlaps.argmax()] = False
            judged.append((score, True))
        elif pairwise_iou(corners, ignored).max(initial=0) < MATCH_IOU:
            judged.append((score, False))
    return judged


def average_precision(hits: Numbers | np.ndarray, objects: int) -> float:
    """Return the area under the precision-recall curve.

    Args:
        hits: (N,) whether each detection is right, the best score first.
        objects: how many were to be found, at least 1.
    """
    right = np.cumsum(hits)
    precision = right / np.arange(1, len(hits) + 1)
    recall = right / objects
    best_from_here = np.maximum.accumulate(precision[::-1])[::-1]
    steps = np.diff(np.concatenate([[0.0], recall]))
    return float((steps * best_from_here).sum())
