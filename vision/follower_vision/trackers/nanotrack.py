"""NanoTrack: a light Siamese network that finds the first frame's target again."""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image
from follower_vision.onnx_network import (
    CPU,
    ModelError,
    Network,
    Tensor,
    read_model,
    with_input_size,
)
from follower_vision.trackers.motion_tracker import MotionEstimate, ResponseMap


@dataclass(frozen=True, slots=True)
class NanoTrackResponse:
    """What the head says about each of N cells of the search crop, in the crop's own pixels.

    Attributes:
        scores: (N,) likeness to the template, 0 to 1.
        corners: (N, 4) left, top, right, bottom, from the crop's middle.
    """

    scores: Tensor
    corners: Tensor


IN_FIRST_SHAPE = ("sides", "in the first box's shape")
"""Metadata of a head whose distances are to be multiplied by the first box's shape."""


class NanoTrackNetwork:
    """Compares a template with a search crop by two ONNX networks.

    The networks are those of HonglinChu's SiamTrackers, versions 1 to 3.

    Attributes:
        search_side: side of the search crop in pixels.
        template_side: side of the template crop in pixels, half of it.
        cells: side of the square of cells that the head answers.
    """

    def __init__(self, backbone: Path, head: Path, device: str = CPU) -> None:
        """Load both networks.

        Raises:
            ModelError: a file is missing, broken or no part of a NanoTrack network.
        """
        self._backbone = Network(backbone, device)
        self.search_side = _search_side(self._backbone)
        self.template_side = self.search_side // 2
        self._template_backbone = _backbone_of_side(backbone, self.template_side, device)
        self._head = Network(head, device)
        name, wanted = IN_FIRST_SHAPE
        self._in_first_shape = self._head.metadata.get(name) == wanted
        self.cells = _cells(self._head)
        self._points = _points(self.cells, _stride(self.search_side, self.cells))
        self._search = np.empty((1, 3, self.search_side, self.search_side), np.float32)

    def template(self, crop: Image) -> Tensor:
        """Return the features of a template crop of (template_side, template_side, 3) pixels."""
        tensor = np.ascontiguousarray(crop.transpose(2, 0, 1)[None], dtype=np.float32)
        return self._template_backbone.run(tensor)[0]

    def features(self, crop: Image) -> Tensor:
        """Return the features, (1, C, H, W), of a search crop of (search_side, search_side, 3)."""
        np.copyto(self._search[0], crop.transpose(2, 0, 1))
        return self._backbone.run(self._search)[0]

    def match(
        self, template: Tensor, features: Tensor, shape: tuple[float, float] = (1.0, 1.0)
    ) -> NanoTrackResponse:
        """Search for a template among a search crop's features.

        Args:
            template: its features.
            features: the search crop's.
            shape: width and height of the box that the template shows, over their geometric mean;
                it only counts for a head that measures sides by it (`IN_FIRST_SHAPE`).
        """
        classes, distances = self._head.run(template, features)
        if self._in_first_shape:
            distances = distances * np.array([*shape, *shape], np.float32)[None, :, None, None]
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


def _backbone_of_side(path: Path, side: int, device: str) -> Network:
    """Load the backbone for a smaller crop than its file states."""
    try:
        resized = with_input_size(read_model(path), (1, 3, side, side))
    except ValueError as error:
        raise ModelError(f"{path}: not a NanoTrack backbone: {error}") from error
    return Network(path, device, resized)


def _cells(head: Network) -> int:
    shapes = list(head.outputs.values())
    channels = [shape[1] for shape in shapes if len(shape) == 4]
    if len(head.inputs) != 2 or channels != [2, 4] or shapes[0][2] <= 0:
        raise ModelError(f"{head.path}: not a NanoTrack head: its outputs are {shapes}")
    return shapes[0][2]


def _stride(side: int, cells: int) -> int:
    """Return the pixels from cell to cell, a power of two: some versions leave the margin out."""
    return 1 << round(math.log2(side / cells))


def _points(cells: int, stride: int) -> npt.NDArray[np.float32]:
    """Return the cells' places from the crop's middle, (cells * cells, 2), row by row."""
    along = (np.arange(cells, dtype=np.float32) - cells // 2) * stride
    across, down = np.meshgrid(along, along)
    return np.stack([across.ravel(), down.ravel()], axis=1)


def _target_share(classes: Tensor) -> Tensor:
    """Return the second channel's share under a softmax of (1, 2, n, n), flat."""
    background, target = classes.reshape(2, -1)
    return np.asarray(1.0 / (1.0 + np.exp(background - target)), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class NanoTrackSettings:
    """The constants of SiamTrackers' NanoTrack, as its author tuned them for version 2.

    Attributes:
        window_influence: weight of nearness to the last place against likeness, 0 to 1.
        penalty_k: how much a change of size or shape costs.
        learning_rate: how fast the size follows what is seen, 0 to 1.
        context: margin about the target, as a share of width plus height.
        smallest_side_px: a box's sides never become shorter.
    """

    window_influence: float = 0.490
    penalty_k: float = 0.150
    learning_rate: float = 0.385
    context: float = 0.5
    smallest_side_px: float = 3.0


NANOTRACK_SETTINGS = {
    1: NanoTrackSettings(window_influence=0.462, penalty_k=0.148, learning_rate=0.390),
    2: NanoTrackSettings(window_influence=0.490, penalty_k=0.150, learning_rate=0.385),
    3: NanoTrackSettings(window_influence=0.455, penalty_k=0.138, learning_rate=0.348),
}
"""The published settings of each version, from SiamTrackers' configuration files."""


SIAMESE_SETTINGS = NanoTrackSettings(window_influence=0.40, penalty_k=0.10, learning_rate=0.30)
"""Of our own network, which has NanoTrack's form."""


class NanoTracker:
    """Follows a box by NanoTrack (HonglinChu, SiamTrackers).

    Differs from the reference in that crops and boxes are real-valued (no rounding to whole
    pixels) and in that boxes may shrink below 10 pixels.

    Attributes:
        name: a short name for tables and logs.
    """

    def __init__(
        self, network: NanoTrackNetwork, settings: NanoTrackSettings, name: str = "nanotrack"
    ) -> None:
        """Make a tracker that waits for `start`.

        Args:
            network: several trackers in one thread may share it.
            settings: those of the network's version, from `NANOTRACK_SETTINGS`.
            name: for tables and logs.
        """
        self._network = network
        self._settings = settings
        self.name = name
        self._window = _cosine_window(network.cells)
        self._template: Tensor | None = None
        self._shape = (1.0, 1.0)
        self._fill: tuple[float, ...] = ()
        self._box: Box | None = None

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`, (H, W, 3) uint8 BGR."""
        self._fill = tuple(cv2.mean(image)[:3])
        self._template = self._learnt(image, box)
        self._shape = box.width / box.scale, box.height / box.scale
        self._box = box

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """See `ResponseTracker`: the first template stays the only one."""

    def search(self, image: Image, box: Box) -> ResponseMap:
        """See `ResponseTracker`."""
        response, zoom, features = self._search_about(image, box)
        side = self._network.search_side / zoom
        return ResponseMap(
            response.corners / zoom + np.array([box.cx, box.cy] * 2, np.float32),
            response.scores,
            self._penalty(response, box.width * zoom, box.height * zoom),
            Box(box.cx, box.cy, side, side),
            features[0].transpose(1, 2, 0),
        )

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR.

        Raises:
            RuntimeError: `start` was not called.
        """
        box = self._started()
        response, zoom, _ = self._search_about(image, box)
        penalty = self._penalty(response, box.width * zoom, box.height * zoom)
        penalised = np.nan_to_num(penalty * response.scores)
        best = self._best(penalised)
        trust = float(penalised[best])
        if not trust:  # the network's numbers are not finite
            return MotionEstimate(box, 0.0)
        self._box = self._bounded(self._smoothed(box, response, best, zoom, trust), image)
        return MotionEstimate(self._box, float(response.scores[best]))

    def _started(self) -> Box:
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        return self._box

    def _learnt(self, image: Image, box: Box) -> Tensor:
        side = self._context_side(box)
        region = Box(box.cx, box.cy, side, side)
        template_side = self._network.template_side
        cut = crop(image, region, template_side, template_side, self._fill)
        return self._network.template(cut)

    def _context_side(self, box: Box) -> float:
        """Return the side of the square about a target, margin included, in image pixels."""
        return context_side(box, self._settings.context)

    def _search_about(self, image: Image, box: Box) -> tuple[NanoTrackResponse, float, Tensor]:
        """Return the network's answer about `box`, crop pixels per image pixel, and features."""
        if self._template is None:
            raise RuntimeError("the tracker was not started")
        side = self._network.search_side
        zoom = self._network.template_side / self._context_side(box)
        region = Box(box.cx, box.cy, side / zoom, side / zoom)
        features = self._network.features(crop(image, region, side, side, self._fill))
        return self._network.match(self._template, features, self._shape), zoom, features

    def _penalty(self, response: NanoTrackResponse, width: float, height: float) -> Tensor:
        """Return each cell's factor, at most 1, for a size or shape unlike the last one's."""
        seen = np.maximum(response.corners[:, 2:] - response.corners[:, :2], 1e-3)
        size = _away_from_one(_padded_scale(seen) / _padded_scale(np.array([[width, height]])))
        shape = _away_from_one(seen[:, 0] / seen[:, 1] * (height / width))
        penalty = np.exp((1.0 - size * shape) * self._settings.penalty_k)
        return np.asarray(penalty, dtype=np.float32)

    def _best(self, penalised: Tensor) -> int:
        influence = self._settings.window_influence
        return int(np.argmax(penalised * (1.0 - influence) + self._window * influence))

    def _smoothed(
        self, box: Box, response: NanoTrackResponse, best: int, zoom: float, trust: float
    ) -> Box:
        """Go to the place seen at once, and to the size seen as fast as it is trusted."""
        left, top, right, bottom = (float(edge) / zoom for edge in response.corners[best])
        rate = trust * self._settings.learning_rate
        return Box(
            box.cx + (left + right) / 2,
            box.cy + (top + bottom) / 2,
            max(self._settings.smallest_side_px, box.width + rate * (right - left - box.width)),
            max(self._settings.smallest_side_px, box.height + rate * (bottom - top - box.height)),
        )

    def _bounded(self, box: Box, image: Image) -> Box:
        """Keep the centre on the image and the sides no longer than the image's."""
        height, width = image.shape[:2]
        return Box(
            min(max(box.cx, 0.0), width),
            min(max(box.cy, 0.0), height),
            min(box.width, width),
            min(box.height, height),
        )


def context_side(box: Box, context: float = 0.5) -> float:
    """Return the side of the square about a target, margin included, in the box's own unit."""
    margin = context * (box.width + box.height)
    return math.sqrt((box.width + margin) * (box.height + margin))


def _cosine_window(cells: int) -> Tensor:
    along = np.hanning(cells)
    return np.outer(along, along).ravel().astype(np.float32)


def _padded_scale(sizes: Tensor) -> Tensor:
    """Return the square root of the area with its margin, (N,), of widths and heights (N, 2)."""
    width, height = sizes.T
    margin = (width + height) / 2
    return np.asarray(np.sqrt((width + margin) * (height + margin)))


def _away_from_one(ratio: Tensor) -> Tensor:
    return np.asarray(np.maximum(ratio, 1.0 / ratio))
