"""Pictures with their boxes on one sheet, to be looked at."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from follower.training.detector.labelled import IGNORED, LabelledImage
from follower_vision.detection.candidates import Candidates
from follower_vision.frame import Image

_TRUE, _FOUND, _LEFT_OUT = (80, 220, 60), (60, 170, 255), (150, 150, 150)
_TILE_PX = 224
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def sample_sheet(
    pictures: Sequence[LabelledImage], names: Sequence[str], columns: int = 8
) -> Image:
    """Return pictures with their true boxes: green to be found, grey to be ignored."""
    return _sheet([_with_truth(picture, names) for picture in pictures], columns)


def found_sheet(
    pictures: Sequence[LabelledImage],
    found: Sequence[Candidates],
    names: Sequence[str],
    columns: int = 8,
) -> Image:
    """Return pictures with the true boxes in green and those found in orange, with scores."""
    tiles = []
    for picture, candidates in zip(pictures, found, strict=True):
        tile = _with_truth(picture, ["" for _ in names])
        for corners, score, kind in zip(
            candidates.corners, candidates.scores, candidates.classes, strict=True
        ):
            _draw(tile, corners, _FOUND, f"{names[kind]} {score:.2f}")
        tiles.append(tile)
    return _sheet(tiles, columns)


def _with_truth(picture: LabelledImage, names: Sequence[str]) -> Image:
    tile = picture.image.copy()
    for corners, kind in zip(picture.boxes, picture.classes.tolist(), strict=True):
        ignored = kind == IGNORED
        _draw(tile, corners, _LEFT_OUT if ignored else _TRUE, "" if ignored else names[kind])
    return tile


def _draw(tile: Image, corners: np.ndarray, colour: tuple[int, int, int], label: str) -> None:
    left, top, right, bottom = (round(float(value)) for value in corners)
    cv2.rectangle(tile, (left, top), (right, bottom), colour, 1, cv2.LINE_AA)
    if label:
        at = (max(left, 0) + 2, max(top - 4, 11))
        cv2.putText(tile, label, at, _FONT, 0.4, (20, 20, 20), 3, cv2.LINE_AA)
        cv2.putText(tile, label, at, _FONT, 0.4, colour, 1, cv2.LINE_AA)


def _sheet(tiles: Sequence[Image], columns: int) -> Image:
    size = (_TILE_PX, _TILE_PX)
    small = [cv2.resize(tile, size, interpolation=cv2.INTER_AREA) for tile in tiles]
    blank = np.full((_TILE_PX, _TILE_PX, 3), 255, np.uint8)
    small += [blank] * (-len(small) % columns)
    rows = [np.hstack(small[start : start + columns]) for start in range(0, len(small), columns)]
    return np.asarray(np.vstack(rows), np.uint8)
