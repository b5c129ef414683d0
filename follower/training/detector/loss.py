"""The region layer's loss."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy

from follower.training.detector.labelled_image import IGNORED, LabelledImage
from follower_control.common.strict_config import SettingsError
from follower_vision.detection.families import YOLOV2_STRIDE

Sizes = npt.NDArray[np.float64]

_ALSO_FITS = 0.6
_NOT_EMPTY = 0.6
_LARGEST_EXPONENT = 6.0


def shape_iou(sizes: Sizes, others: Sizes) -> Sizes:
    """Return the overlap, (N, M), of boxes about the same centre, sizes (N, 2) and (M, 2)."""
    common = np.minimum(sizes[:, None], others[None]).prod(axis=2)
    union = sizes.prod(axis=1)[:, None] + others.prod(axis=1)[None] - common
    return np.asarray(common / union)


def find_anchors(sizes: Sizes, count: int, seed: int) -> Sizes:
    """Return `count` typical widths and heights, (count, 2), the smallest first.

    They are the centres of k-means on the logarithms of the sizes.

    Args:
        sizes: (N, 2) widths and heights of boxes, in cells.
        count: how many.
        seed: of the first guess.

    Raises:
        SettingsError: there are fewer different sizes than anchors wanted.
    """
    different = len(np.unique(sizes, axis=0))
    if different < count:
        raise SettingsError(
            "there are too few boxes in the pictures: "
            f"{count} anchors need at least as many boxes of different sizes, not {different}"
        )
    cv2.setRNGSeed(seed)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    logs, unknown = np.log(sizes).astype(np.float32), np.empty(0, np.int32)
    _, _, centres = cv2.kmeans(logs, count, unknown, criteria, 10, cv2.KMEANS_PP_CENTERS)
    anchors = np.exp(np.asarray(centres, np.float64))
    return anchors[np.argsort(anchors.prod(axis=1))]


@dataclass(frozen=True, slots=True)
class Labels:
    """What a batch of answers is compared with; K boxes that an anchor stands for.

    Attributes:
        places: (4, K) picture, anchor, row and column that each box belongs to.
        corners: (K, 4) of the boxes, in cells.
        classes: (K,).
        all_corners: (B, M, 4) of every box, those to be ignored too, in cells; filled with zeros.
        open: (B, rows, columns) whether a cell says something about emptiness: no ignored box
            holds its centre.
    """

    places: Tensor
    corners: Tensor
    classes: Tensor
    all_corners: Tensor
    open: Tensor


def make_labels(
    pictures: Sequence[LabelledImage], anchors: np.ndarray, device: torch.device
) -> Labels:
    """Turn pictures' boxes into a loss's labels.

    A box belongs to the cell that holds its centre, and there to the anchor of the most similar
    shape and to all others whose overlap with it is above 0.6.

    Args:
        pictures: all of the same size.
        anchors: (A, 2) in cells.
        device: where the labels are put.
    """
    rows, columns = (side // YOLOV2_STRIDE for side in pictures[0].image.shape[:2])
    most = max(1, max(len(one.classes) for one in pictures))
    every = np.zeros((len(pictures), most, 4), np.float32)
    opened = np.ones((len(pictures), rows, columns), np.float32)
    places: list[tuple[int, int, int, int]] = []
    chosen: list[np.ndarray] = []
    classes: list[int] = []
    for number, picture in enumerate(pictures):
        cells = picture.boxes / YOLOV2_STRIDE
        every[number, : len(cells)] = cells
        for corners, kind in zip(cells, picture.classes.tolist(), strict=True):
            if kind == IGNORED:
                opened[number][_centres_within(corners, rows, columns)] = 0
                continue
            column, row = ((corners[:2] + corners[2:]) / 2).astype(int).tolist()
            for anchor in _fitting(corners[2:] - corners[:2], anchors):
                places.append((number, anchor, min(row, rows - 1), min(column, columns - 1)))
                chosen.append(corners)
                classes.append(kind)
    return Labels(
        torch.tensor(np.array(places, np.int64).reshape(-1, 4).T, device=device),
        torch.tensor(np.array(chosen, np.float32).reshape(-1, 4), device=device),
        torch.tensor(np.array(classes, np.int64), device=device),
        torch.tensor(every, device=device),
        torch.tensor(opened, device=device),
    )


def _fitting(size: np.ndarray, anchors: np.ndarray) -> list[int]:
    overlaps = shape_iou(size[None].astype(np.float64), anchors)[0]
    return sorted({int(overlaps.argmax()), *np.flatnonzero(overlaps > _ALSO_FITS).tolist()})


def _centres_within(corners: np.ndarray, rows: int, columns: int) -> np.ndarray:
    across, down = np.arange(columns) + 0.5, np.arange(rows) + 0.5
    wide = (across > corners[0]) & (across < corners[2])
    high = (down > corners[1]) & (down < corners[3])
    return np.asarray(high[:, None] & wide[None])


@dataclass(frozen=True, slots=True)
class RegionLoss:
    """Compares a network's answers with labels.

    YOLO v2 adds up squared errors; this is the same region layer with the losses in use today:
    cross-entropy for objectness and class, and 1 - GIoU (Rezatofighi et al., CVPR 2019) for the
    boxes. A place whose box overlaps a true one by more than 0.6 need not predict that it is empty.

    Attributes:
        anchors: (A, 2) widths and heights in cells.
        box_weight: of the boxes.
        empty_weight: of the objectness of empty places.
    """

    anchors: Tensor
    box_weight: float
    empty_weight: float

    def __call__(self, answer: Tensor, labels: Labels) -> Tensor:
        """Return the loss, a scalar, per picture."""
        values = answer.view(len(answer), len(self.anchors), -1, *answer.shape[2:])
        corners = self.corners(values)
        picture, anchor, row, column = labels.places
        empty = self._empty(corners.detach(), labels)
        empty[picture, anchor, row, column] = 0
        emptiness = binary_cross_entropy_with_logits(
            values[:, :, 4], torch.zeros_like(empty), weight=empty, reduction="sum"
        )
        rows = values.movedim(2, -1)[picture, anchor, row, column]
        objectness = binary_cross_entropy_with_logits(
            rows[:, 4], torch.ones_like(rows[:, 4]), reduction="sum"
        )
        kinds = cross_entropy(rows[:, 5:], labels.classes, reduction="sum")
        apart = (1 - giou(corners[picture, anchor, row, column], labels.corners)).sum()
        total: Tensor = (
            self.empty_weight * emptiness + objectness + kinds + self.box_weight * apart
        ) / len(answer)
        return total

    def corners(self, values: Tensor) -> Tensor:
        """Return the predicted corners in cells, (B, A, rows, columns, 4)."""
        rows, columns = values.shape[-2:]
        across = torch.arange(columns, device=values.device, dtype=values.dtype)
        down = torch.arange(rows, device=values.device, dtype=values.dtype)[:, None]
        x, y = values[:, :, 0].sigmoid() + across, values[:, :, 1].sigmoid() + down
        width, height = self.anchors[:, 0, None, None], self.anchors[:, 1, None, None]
        half_width = values[:, :, 2].clamp(max=_LARGEST_EXPONENT).exp() * width / 2
        half_height = values[:, :, 3].clamp(max=_LARGEST_EXPONENT).exp() * height / 2
        return torch.stack(
            [x - half_width, y - half_height, x + half_width, y + half_height], dim=-1
        )

    def _empty(self, corners: Tensor, labels: Labels) -> Tensor:
        """Return 1 where a place has to say that nothing is there, (B, A, rows, columns)."""
        flat = corners.flatten(1, 3)
        common, union = _common_and_union(flat[:, :, None], labels.all_corners[:, None])
        overlap = (common / union.clamp(min=1e-9)).amax(dim=2)
        empty = (overlap < _NOT_EMPTY).to(corners.dtype).view(corners.shape[:-1])
        return empty * labels.open[:, None]


def _common_and_union(corners: Tensor, others: Tensor) -> tuple[Tensor, Tensor]:
    """Return the areas of intersection and union of boxes (..., 4) that broadcast."""
    low = torch.maximum(corners[..., :2], others[..., :2])
    high = torch.minimum(corners[..., 2:], others[..., 2:])
    common = (high - low).clamp(min=0).prod(dim=-1)
    areas, other_areas = ((one[..., 2:] - one[..., :2]).prod(dim=-1) for one in (corners, others))
    return common, areas + other_areas - common


def giou(corners: Tensor, others: Tensor) -> Tensor:
    """Return the generalised intersection over union, (K,), of boxes (K, 4) pair by pair."""
    common, union = _common_and_union(corners, others)
    low = torch.minimum(corners[:, :2], others[:, :2])
    high = torch.maximum(corners[:, 2:], others[:, 2:])
    hull = (high - low).prod(dim=1).clamp(min=1e-9)
    return common / union.clamp(min=1e-9) - (hull - union) / hull
