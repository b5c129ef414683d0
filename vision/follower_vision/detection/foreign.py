"""Answers of other libraries as detections, e.g. `supervision.Detections` of a plug-in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from follower_vision.detection.detection import Detection
from follower_vision.geometry.box import Box


def as_detections(answer: Any, class_names: Sequence[str]) -> list[Detection]:
    """Return a detector's answer as it is, or one shaped as `supervision.Detections`.

    That has arrays over N objects: `xyxy` (N, 4) in pixels of the whole image; `confidence` (N,),
    taken as 1 where there is none, as a tracker's; `class_id` (N,), likewise 0; `mask`
    (N, H, W) of a segmentation, whose bounds then are the boxes; `tracker_id` (N,) of a
    multi-object tracker, by which objects without a track are left out. Fusion chooses by how
    things look and move, so that a track's number is no proof and goes no further.

    Args:
        answer: of the detector.
        class_names: by number.

    Raises:
        ValueError: the arrays do not fit.
    """
    if not hasattr(answer, "xyxy"):
        return answer  # type: ignore[no-any-return]
    corners = np.asarray(answer.xyxy, np.float64).reshape(-1, 4)
    masks, numbers = getattr(answer, "mask", None), getattr(answer, "tracker_id", None)
    scores = _given(answer, "confidence", np.ones(len(corners)))
    classes = _given(answer, "class_id", np.zeros(len(corners), int))
    found = []
    for row, (left, top, right, bottom) in enumerate(corners.tolist()):
        if numbers is not None and (numbers[row] is None or numbers[row] < 0):
            continue
        if masks is not None and np.any(masks[row]):
            left, right = _bounds(np.any(masks[row], axis=0))
            top, bottom = _bounds(np.any(masks[row], axis=1))
        if right <= left or bottom <= top:
            continue  # one without area says nothing of the others
        number = int(classes[row])
        name = class_names[number] if 0 <= number < len(class_names) else str(number)
        box = Box.from_xywh(left, top, right - left, bottom - top)
        found.append(Detection(box, number, name, float(scores[row])))
    return sorted(found, key=lambda one: -one.score)


def _given(answer: Any, name: str, usual: Any) -> Any:
    values = getattr(answer, name, None)
    if values is None:
        return usual
    if len(values) != len(usual):
        raise ValueError(f"{name} has {len(values)} rows, xyxy {len(usual)}")
    return values


def _bounds(filled: Any) -> tuple[float, float]:
    """Return where the first filled pixel begins and the last one ends."""
    places = np.flatnonzero(filled)
    return float(places[0]), float(places[-1]) + 1.0
