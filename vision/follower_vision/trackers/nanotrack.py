"""NanoTrack: a light Siamese network that finds the first frame's target again."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from follower_vision.box import Box
from follower_vision.crop import crop
from follower_vision.frame import Image
from follower_vision.motion import MotionEstimate
from follower_vision.nanotrack_network import TEMPLATE_SIDE, NanoTrackNetwork, NanoTrackResponse
from follower_vision.nanotrack_settings import NanoTrackSettings
from follower_vision.network import Tensor
from follower_vision.nms import keep_best

_SAME_SIZE = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """What the network said.

    Attributes:
        image: in which.
        box: about which it looked.
        response: its answer, in the crop's pixels.
        zoom: crop pixels per image pixel.
    """

    image: Image
    box: Box
    response: NanoTrackResponse
    zoom: float


class NanoTracker:
    """Follows a box by NanoTrack (HonglinChu, SiamTrackers).

    Differs from the reference in that crops and boxes are real-valued (no rounding to whole
    pixels) and in that boxes may shrink below 10 pixels.
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
        self._name = name
        self._window = _cosine_window(network.cells)
        self._template: Tensor | None = None
        self._fill: tuple[float, ...] = ()
        self._box: Box | None = None
        self._answer: _Answer | None = None

    @property
    def name(self) -> str:
        """A short name for tables and logs."""
        return self._name

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`, (H, W, 3) uint8 BGR."""
        self._fill = tuple(cv2.mean(image)[:3])
        side = self._context_side(box)
        region = Box(box.cx, box.cy, side, side)
        cut = crop(image, region, TEMPLATE_SIDE, TEMPLATE_SIDE, self._fill)
        self._template = self._network.template(cut)
        self._box = box
        self._answer = None

    def move_to(self, box: Box) -> None:
        """Search about `box` next time, without learning the target anew.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._started()
        self._box = box

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR.

        Raises:
            RuntimeError: `start` was not called.
        """
        box = self._started()
        response, zoom = self._look(image, box)
        self._answer = _Answer(image, box, response, zoom)
        penalty = self._penalty(response, box.width * zoom, box.height * zoom)
        best = self._best(penalty * response.scores)
        trust = float(penalty[best] * response.scores[best])
        self._box = self._bounded(self._smoothed(box, response, best, zoom, trust), image)
        return MotionEstimate(self._box, float(response.scores[best]))

    def candidates(self, least: float = 0.0) -> list[MotionEstimate]:
        """Return every place like the target that the last `update` saw, the likest first.

        The boxes are as the network sees them, not smoothed over time, and nearness to the last
        place does not count: a look-alike beside the target is among them.

        Args:
            least: only those with this confidence, 0 to 1.
        """
        if self._answer is None:
            return []
        return self._places(self._answer, least)

    def probe(self, image: Image, box: Box) -> list[MotionEstimate]:
        """Look for the target about another box, and tell the places without going there.

        The window is about four times the box's size; the likest place comes first, and the list
        is empty where nothing is like the target. Where the last `update` saw the same place in
        the same image, its answer serves.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._started()
        answer = self._answer
        if answer is None or answer.image is not image or not self._covers(answer, box):
            response, zoom = self._look(image, box)
            answer = _Answer(image, box, response, zoom)
        return self._places(answer)

    def _covers(self, answer: _Answer, box: Box) -> bool:
        """Whether a box, as large as the one looked for, lies in the inner half of the window."""
        reach = self._network.search_side / answer.zoom / 4
        across, down = abs(box.cx - answer.box.cx), abs(box.cy - answer.box.cy)
        alike = 1 / _SAME_SIZE < box.scale / answer.box.scale < _SAME_SIZE
        return alike and max(across, down) <= reach

    def _started(self) -> Box:
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        return self._box

    def _context_side(self, box: Box) -> float:
        """Return the side of the square about a target, margin included, in image pixels."""
        margin = self._settings.context * (box.width + box.height)
        return math.sqrt((box.width + margin) * (box.height + margin))

    def _look(self, image: Image, box: Box) -> tuple[NanoTrackResponse, float]:
        """Return the network's answer about `box`, and crop pixels per image pixel."""
        if self._template is None:
            raise RuntimeError("the tracker was not started")
        side = self._network.search_side
        zoom = TEMPLATE_SIDE / self._context_side(box)
        region = Box(box.cx, box.cy, side / zoom, side / zoom)
        cut = crop(image, region, side, side, self._fill)
        return self._network.compare(self._template, cut), zoom

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

    def _places(self, answer: _Answer, least: float = 0.0) -> list[MotionEstimate]:
        settings, response = self._settings, answer.response
        likely = np.flatnonzero(response.scores >= max(settings.candidate_score, least))
        corners, scores = response.corners[likely] / answer.zoom, response.scores[likely]
        kept = keep_best(corners, scores, settings.candidate_overlap, settings.candidates)
        return [
            MotionEstimate(_box_about(answer.box, corners[index]), float(scores[index]))
            for index in kept
        ]


def _box_about(box: Box, corners: Tensor) -> Box:
    left, top, right, bottom = (float(edge) for edge in corners)
    return Box(box.cx + (left + right) / 2, box.cy + (top + bottom) / 2, right - left, bottom - top)


def _cosine_window(cells: int) -> Tensor:
    along = np.hanning(cells)
    return np.outer(along, along).ravel().astype(np.float32)


def _padded_scale(sizes: Tensor) -> Tensor:
    """Return the square root of the area with its margin, (N,), of widths and heights (N, 2)."""
    return np.asarray(np.sqrt(np.prod(sizes + sizes.mean(axis=1, keepdims=True), axis=1)))


def _away_from_one(ratio: Tensor) -> Tensor:
    return np.asarray(np.maximum(ratio, 1.0 / ratio))
