"""The two networks of NanoTrack: a backbone for both crops and a head that compares them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.frame import Image
from follower_vision.network import ModelError, Network, Tensor, read_model
from follower_vision.onnxresize import with_input_size

TEMPLATE_SIDE = 127
STRIDE = 16


@dataclass(frozen=True, slots=True)
class NanoTrackResponse:
    """What the head says about each of N cells of the search crop, in the crop's own pixels.

    Attributes:
        scores: (N,) likeness to the template, 0 to 1.
        corners: (N, 4) left, top, right, bottom, from the crop's middle.
    """

    scores: Tensor
    corners: Tensor


class NanoTrackNetwork:
    """Compares a template with a search crop by two ONNX networks.

    The networks are those of HonglinChu's SiamTrackers, versions 1 to 3.

    Attributes:
        search_side: side of the search crop in pixels.
        cells: side of the square of cells that the head answers.
    """

    def __init__(self, backbone: Path, head: Path, threads: int = 1) -> None:
        """Load both networks.

        Raises:
            ModelError: a file is missing, broken or no part of a NanoTrack network.
        """
        self._backbone = Network(backbone, threads)
        self.search_side = _search_side(self._backbone)
        self._template_backbone = _backbone_of_side(backbone, TEMPLATE_SIDE, threads)
        self._head = Network(head, threads)
        self.cells = _cells(self._head)
        self._points = _points(self.cells)
        self._search = np.empty((1, 3, self.search_side, self.search_side), np.float32)

    def template(self, crop: Image) -> Tensor:
        """Return the features of a template crop of (127, 127, 3) pixels."""
        tensor = np.ascontiguousarray(crop.transpose(2, 0, 1)[None], dtype=np.float32)
        return self._template_backbone.run(tensor)[0]

    def compare(self, template: Tensor, crop: Image) -> NanoTrackResponse:
        """Look for a template in a search crop of (search_side, search_side, 3) pixels."""
        np.copyto(self._search[0], crop.transpose(2, 0, 1))
        features = self._backbone.run(self._search)[0]
        classes, distances = self._head.run(template, features)
        return NanoTrackResponse(_target_share(classes), self._corners(distances))

    def _corners(self, distances: Tensor) -> Tensor:
        """Turn distances to the left, top, right and bottom side, (1, 4, n, n), into corners."""
        to_sides = distances.reshape(4, -1).T
        return np.hstack([self._points - to_sides[:, :2], self._points + to_sides[:, 2:]])


def _search_side(backbone: Network) -> int:
    shapes = list(backbone.inputs.values())
    if len(shapes) != 1 or len(shapes[0]) != 4 or shapes[0][1] != 3 or shapes[0][2] <= 0:
        raise ModelError(f"{backbone.path}: not a NanoTrack backbone: its inputs are {shapes}")
    return shapes[0][2]


def _backbone_of_side(path: Path, side: int, threads: int) -> Network:
    """Load the backbone for a smaller crop than its file states."""
    try:
        resized = with_input_size(read_model(path), (1, 3, side, side))
    except ValueError as error:
        raise ModelError(f"{path}: not a NanoTrack backbone: {error}") from error
    return Network(path, threads, resized)


def _cells(head: Network) -> int:
    shapes = list(head.outputs.values())
    channels = [shape[1] for shape in shapes if len(shape) == 4]
    if len(head.inputs) != 2 or channels != [2, 4] or shapes[0][2] <= 0:
        raise ModelError(f"{head.path}: not a NanoTrack head: its outputs are {shapes}")
    return shapes[0][2]


def _points(cells: int) -> npt.NDArray[np.float32]:
    """Return the cells' places from the crop's middle, (cells * cells, 2), row by row."""
    along = (np.arange(cells, dtype=np.float32) - cells // 2) * STRIDE
    across, down = np.meshgrid(along, along)
    return np.stack([across.ravel(), down.ravel()], axis=1)


def _target_share(classes: Tensor) -> Tensor:
    """Return the second channel's share under a softmax of (1, 2, n, n), flat."""
    background, target = cv2.split(classes[0].transpose(1, 2, 0))
    return np.asarray(1.0 / (1.0 + np.exp(background - target)), dtype=np.float32).ravel()
