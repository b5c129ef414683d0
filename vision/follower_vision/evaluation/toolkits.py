"""One-pass figures as got10k-toolkit 0.1.3 and vot-toolkit 0.9.0 count them, to the last digit.

They differ from ours, and from one another: OTB's protocol scores the first frame, which every
tracker has right; GOT-10k's cuts boxes at the image's edge, in its own way, and pools the frames of
all sequences; VOT's rounds boxes to whole pixels, leaves out ten frames after the start, and weighs
sequences by their length. Here they are, so that a figure can stand beside a published one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.evaluation.metrics import PRECISION_PX, SUCCESS_AT, SUCCESS_IOU
from follower_vision.geometry.box import Box

VOT_BURN_IN = 10
"""Frames from a start on that VOT's accuracy leaves out."""

_Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ToolkitScore:
    """One-pass figures by the toolkits' protocols, of a sequence or of several.

    Attributes:
        otb_success: `success_score` of got10k-toolkit's ExperimentOTB, ExperimentUAV123, …
        otb_precision: `precision_score`: centre within 20 px.
        otb_rate: `success_rate`: overlap above 0.5.
        got10k_ao: `ao` of its ExperimentGOT10k: the average overlap.
        got10k_sr: `sr`: overlap above 0.5.
        vot_accuracy: vot-toolkit's `average_accuracy` of an unsupervised experiment; None where
            the data set's regions are no boxes.
        overlaps: number of frames that GOT-10k's protocol scores.
        frames: number of all frames.
    """

    otb_success: float
    otb_precision: float
    otb_rate: float
    got10k_ao: float
    got10k_sr: float
    vot_accuracy: float | None
    overlaps: int
    frames: int


def toolkit_score(
    boxes: Sequence[Box | None],
    truth: Sequence[Box | None],
    image_size: tuple[int, int],
    rectangles: bool = True,
) -> ToolkitScore:
    """Score one sequence.

    Args:
        boxes: the tracker's, one a frame, the initial one first, in pixels; None is a miss.
        truth: one a frame, in pixels; None where the target is absent. The first is a box.
        image_size: width and height in pixels.
        rectangles: the data set's regions are boxes; `Sequence.rectangles`.

    Raises:
        ValueError: the lengths differ, or no frame after the first one has a true box.
    """
    pairs = [
        (frame, box, true)
        for frame, (box, true) in enumerate(zip(boxes, truth, strict=True))
        if true is not None
    ]
    if len(pairs) < 2:
        raise ValueError("no frame after the first one has a true box")
    true = np.array([one.xywh for _, _, one in pairs])
    answered = np.array([(np.nan,) * 4 if box is None else box.xywh for _, box, _ in pairs])
    answered[0] = true[0]
    overlaps, off_px = _overlaps(answered, true), _distances(answered, true)
    inside = _overlaps(_bounded(answered[1:], image_size), _bounded(true[1:], image_size))
    later = np.array([frame for frame, _, _ in pairs]) >= VOT_BURN_IN
    rasterised = _rasterised_overlaps(answered[later], true[later], image_size)
    return ToolkitScore(
        float(np.mean(overlaps[:, None] > SUCCESS_AT)),
        float(np.mean(off_px <= PRECISION_PX)),
        float(np.mean(overlaps > SUCCESS_IOU)),
        float(np.mean(inside)),
        float(np.mean(inside > SUCCESS_IOU)),
        (float(np.mean(rasterised)) if later.any() else 0.0) if rectangles else None,
        len(inside),
        len(truth),
    )


def mean_toolkit_score(scores: Sequence[ToolkitScore]) -> ToolkitScore:
    """Bring sequences together as each toolkit does.

    Raises:
        ValueError: there is none.
    """
    overlaps, frames = [one.overlaps for one in scores], [one.frames for one in scores]
    accuracies = [one.vot_accuracy for one in scores if one.vot_accuracy is not None]
    return ToolkitScore(
        float(np.mean([one.otb_success for one in scores])),
        float(np.mean([one.otb_precision for one in scores])),
        float(np.mean([one.otb_rate for one in scores])),
        float(np.average([one.got10k_ao for one in scores], weights=overlaps)),
        float(np.average([one.got10k_sr for one in scores], weights=overlaps)),
        float(np.average(accuracies, weights=frames)) if len(accuracies) == len(scores) else None,
        sum(overlaps),
        sum(frames),
    )


def _overlaps(boxes: _Floats, true: _Floats) -> _Floats:
    """Return intersection over union as got10k-toolkit's `rect_iou`; 0 without a box."""
    low = np.maximum(boxes[:, :2], true[:, :2])
    high = np.minimum(boxes[:, :2] + boxes[:, 2:], true[:, :2] + true[:, 2:])
    common = np.prod(np.maximum(high - low, 0), axis=1)
    union = np.prod(boxes[:, 2:], axis=1) + np.prod(true[:, 2:], axis=1) - common
    return np.asarray(np.nan_to_num(np.clip(common / (union + np.finfo(float).eps), 0, 1)))


def _distances(boxes: _Floats, true: _Floats) -> _Floats:
    """Return the distance of the centres in pixels as its `center_error`."""
    centres, true_centres = (one[:, :2] + (one[:, 2:] - 1) / 2 for one in (boxes, true))
    return np.asarray(np.sqrt(np.sum(np.power(centres - true_centres, 2), axis=1)))


def _bounded(boxes: _Floats, image_size: tuple[int, int]) -> _Floats:
    """Cut boxes as `rect_iou` does: a corner is moved inside, the size is kept while it fits."""
    corner = np.clip(boxes[:, :2], 0, image_size)
    return np.hstack([corner, np.clip(boxes[:, 2:], 0, np.array(image_size) - corner)])


def _rasterised_overlaps(boxes: _Floats, true: _Floats, image_size: tuple[int, int]) -> _Floats:
    """Return vot-toolkit's `calculate_overlap` of boxes: by whole pixels of the image."""
    first, last = _pixels(np.nan_to_num(boxes))
    true_first, true_last = _pixels(true)
    low, high = np.minimum(first, true_first), np.maximum(last, true_last)
    seen_low, seen_high = np.maximum(low, 0), np.minimum(high, np.array(image_size) - 1)
    areas = [
        np.prod(np.maximum(np.minimum(end, seen_high) - np.maximum(begin, seen_low) + 1, 0), axis=1)
        for begin, end in (
            (first, last),
            (true_first, true_last),
            (np.maximum(first, true_first), np.minimum(last, true_last)),
        )
    ]
    union = areas[0] + areas[1] - areas[2]
    overlaps = np.divide(areas[2], union, out=np.zeros(len(boxes)), where=union > 0)
    overlaps[np.any(seen_low >= seen_high, axis=1)] = 0
    overlaps[np.any(low >= high, axis=1)] = 1
    return np.asarray(overlaps)


def _pixels(boxes: _Floats) -> tuple[_Floats, _Floats]:
    """Return the first and the last pixel of each box, rounded in single precision as there."""
    rounded = np.round(boxes.astype(np.float32)).astype(np.float64)
    return rounded[:, :2], rounded[:, :2] + rounded[:, 2:] - 1
