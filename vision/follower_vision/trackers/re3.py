"""Re3: a recurrent network that predicts where the last frame's box has moved.

A target's scale is the side of the square of equal area. Both of the network's crops are squares
about the last box's centre, at the zoom that makes the scale `TARGET_PX` pixels.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image
from follower_vision.onnx_network import CPU, ModelError, Network, Tensor
from follower_vision.trackers.motion_tracker import MotionEstimate, ResponseMap

TARGET_PX = 40
TEMPLATE_PX = 64
SEARCH_PX = 128
CELL_PX = 8
PLACES = SEARCH_PX // CELL_PX + 1

_MOST_GROWTH = 0.5
INPUTS = ("previous", "present", "size", "memory", "memory_size", "hidden", "cell")
OUTPUTS = ("box", "confidence", "features", "hidden", "cell")


def template_region(box: Box) -> Box:
    """Return what the template crop about a box covers, in the image's pixels."""
    side = box.scale * TEMPLATE_PX / TARGET_PX
    return Box(box.cx, box.cy, side, side)


def search_region(box: Box) -> Box:
    """Return what the search crop about a box covers, in the image's pixels."""
    side = box.scale * SEARCH_PX / TARGET_PX
    return Box(box.cx, box.cy, side, side)


def relative_size(box: Box) -> tuple[float, float]:
    """Return a box's width and height in units of its scale."""
    return box.width / box.scale, box.height / box.scale


def relative_box(box: Box, last: Box) -> tuple[float, float, float, float]:
    """Return a box as the network is taught to say it, seen from the last one.

    That is the centre's shift in the last box's scales, and the logarithms of the growth of width
    and height.
    """
    scale = last.scale
    return (
        (box.cx - last.cx) / scale,
        (box.cy - last.cy) / scale,
        math.log(box.width / last.width),
        math.log(box.height / last.height),
    )


def absolute_box(answer: npt.NDArray[np.float32], last: Box) -> Box:
    """Return the box in the image that an answer (4,) means; the inverse of `relative_box`."""
    x, y, wider, taller = (float(value) for value in answer)
    wider = min(max(wider, -_MOST_GROWTH), _MOST_GROWTH)
    taller = min(max(taller, -_MOST_GROWTH), _MOST_GROWTH)
    return Box(
        last.cx + x * last.scale,
        last.cy + y * last.scale,
        last.width * math.exp(wider),
        last.height * math.exp(taller),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Re3Memory:
    """What was learnt of the target when the track began.

    Attributes:
        features: (1, C, 8, 8) of its template crop.
        size: (1, 2) its width and height in target scales.
    """

    features: Tensor
    size: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class Re3State:
    """What both LSTM layers carry from frame to frame, (2, 1, hidden) each."""

    hidden: Tensor
    cell: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class Re3Output:
    """What the network says about one frame.

    Attributes:
        box: (4,) as `absolute_box` takes it.
        confidence: 0 to 1, the likelihood that the box is right (overlap above a half), as it was
            on generated sequences.
        features: of the view of the frame before.
        state: for the next frame.
    """

    box: Tensor
    confidence: float
    features: Tensor
    state: Re3State

    @property
    def is_finite(self) -> bool:
        """Whether all of its numbers are."""
        numbers = (self.box, self.confidence, self.features, self.state.hidden, self.state.cell)
        return all(np.isfinite(one).all() for one in numbers)


class Re3Network:
    """Takes two crops and predicts where the target is; several trackers may share it."""

    def __init__(self, path: Path, device: str = CPU) -> None:
        """Load the network.

        Raises:
            ModelError: the file is missing, broken or no Re3 network of ours.
        """
        self._network = Network(path, device)
        if tuple(self._network.inputs) != INPUTS or len(self._network.outputs) != len(OUTPUTS):
            names = ", ".join(self._network.inputs)
            raise ModelError(f"{path}: not a Re3 network of ours: its inputs are {names}")
        self._no_features = np.zeros(self._network.inputs["memory"], np.float32)
        self._no_state = np.zeros(self._network.inputs["hidden"], np.float32)

    @property
    def first_state(self) -> Re3State:
        """What is remembered before anything was seen."""
        return Re3State(self._no_state, self._no_state)

    def view(self, image: Image, box: Box, fill: tuple[float, ...]) -> Image:
        """Return what a box shows, as the network wants to see it a frame later.

        Args:
            image: (H, W, 3) uint8 BGR.
            box: in pixels.
            fill: colour of what lies outside the image.
        """
        return crop(image, template_region(box), TEMPLATE_PX, TEMPLATE_PX, fill)

    def learn(self, image: Image, box: Box, fill: tuple[float, ...]) -> tuple[Re3Memory, Re3State]:
        """Return what there is to remember of a target in its first image."""
        view, blank = self.view(image, box, fill), Re3Memory(self._no_features, _size(box))
        features = self.predict(view, image, box, fill, blank, self.first_state).features
        memory = Re3Memory(features, _size(box))
        return memory, self.predict(view, image, box, fill, memory, self.first_state).state

    def predict(
        self,
        view: Image,
        image: Image,
        box: Box,
        fill: tuple[float, ...],
        memory: Re3Memory,
        state: Re3State,
    ) -> Re3Output:
        """Search for the target about a place.

        Args:
            view: of the target in the frame before.
            image: (H, W, 3) uint8 BGR, the present frame.
            box: the place, in pixels, and the target's size.
            fill: colour of what lies outside the image.
            memory: of the target.
            state: after the frame before.
        """
        outputs = self._network.run(
            _tensor(view),
            _tensor(crop(image, search_region(box), SEARCH_PX, SEARCH_PX, fill)),
            _size(box),
            memory.features,
            memory.size,
            state.hidden,
            state.cell,
        )
        answer, confidence, features, hidden, cell = outputs
        return Re3Output(
            answer[0], float(confidence.reshape(-1)[0]), features, Re3State(hidden, cell)
        )


def _tensor(image: Image) -> Tensor:
    return np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32)


def _size(box: Box) -> Tensor:
    return np.array([relative_size(box)], np.float32)


@dataclass(frozen=True, slots=True)
class Re3Settings:
    """How the network's answers are used.

    Attributes:
        reset_frames: what the LSTM layers remember goes back to what it was after the first frame
            each time so many frames have passed; the paper's number.
        smallest_side_px: no side of the box becomes shorter, in pixels.
        confidence_power: the confidence is the network's likelihood raised to this. Fusion takes a
            confidence of less than 0.8 of the usual one for a loss: on generated sequences every
            second box has nothing of the target where the likelihood is 0.025 of the usual one
            (benchmarks/re3_confidence.py).
    """

    reset_frames: int = 32
    smallest_side_px: float = 4.0
    confidence_power: float = 0.06


NO_SETTINGS = Re3Settings()


@dataclass(frozen=True, slots=True, eq=False)
class _Before:
    """What the next answer depends on besides the image and the place.

    Attributes:
        view: what the target looked like last.
        state: of the LSTM layers.
        frames: how many these remember, the first one not counted.
    """

    view: Image
    state: Re3State
    frames: int


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """The network's output for an image.

    Attributes:
        image: which.
        box: where the target is.
        state: of the LSTM layers, for the next frame.
    """

    image: Image
    box: Box
    state: Re3State


class Re3Tracker:
    """Follows a box by our Re3 network.

    After Gordon, Farhadi and Fox, "Re3: Real-Time Recurrent Regression Networks for Visual
    Tracking of Generic Objects" (RA-L 2018); docs/how-to/train-re3.md lists the departures.

    It can be sent elsewhere: what it saw last, what it remembers and where it searches are three
    things. However often it searches one image, the next image counts as the next frame, and what
    it saw last is where its last search found the target.
    """

    def __init__(
        self, network: Re3Network, settings: Re3Settings = NO_SETTINGS, name: str = "re3"
    ) -> None:
        """Make a tracker that waits for `start`.

        Args:
            network: several trackers in one thread may share it.
            settings: how its answers are used.
            name: for tables and logs.
        """
        self.name = name
        self._network = network
        self._settings = settings
        self._memory: Re3Memory | None = None
        self._first_state: Re3State = network.first_state
        self._fill: tuple[float, ...] = ()
        self._box: Box | None = None
        self._before: _Before | None = None
        self._answer: _Answer | None = None
        self._pending: _Answer | None = None

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`, (H, W, 3) uint8 BGR."""
        self._fill = tuple(cv2.mean(image)[:3])
        box = self._bounded(box, image)
        self._memory, self._first_state = self._network.learn(image, box, self._fill)
        self._go_on_from(image, box)

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR.

        The same image object is the same frame: then it searches once more.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._remember_last(image)
        estimate, self._answer = self._search(image, self._started())
        self._box = estimate.box
        return estimate

    def search(self, image: Image, box: Box) -> ResponseMap:
        """See `ResponseTracker`: the one place that the network names.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._started()
        self._remember_last(image)
        estimate, self._pending = self._search(image, box)
        found = estimate.box
        score = np.array([estimate.confidence])
        corners = np.array([[found.left, found.top, found.right, found.bottom]])
        return ResponseMap(corners, score, np.ones(1), box.scaled(SEARCH_PX / TARGET_PX))

    def learn(self, image: Image, box: Box, probability: float) -> None:  # noqa: ARG002
        """See `ResponseTracker`: the network remembers what it is told was right, and no more."""
        if self._pending is not None and self._pending.image is image:
            self._answer = replace(self._pending, box=self._bounded(box, image))
            self._pending = None

    def _started(self) -> Box:
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        return self._box

    def _go_on_from(self, image: Image, box: Box) -> None:
        self._before = _Before(self._network.view(image, box, self._fill), self._first_state, 0)
        self._box, self._answer = box, None

    def _remember_last(self, image: Image) -> None:
        """Take what the last image showed, if this is another one."""
        last, before = self._answer, self._before
        if last is None or before is None or last.image is image:
            return
        view = self._network.view(last.image, last.box, self._fill)
        state, frames = last.state, before.frames + 1
        if frames >= self._settings.reset_frames:
            state, frames = self._first_state, 0
        self._before, self._answer = _Before(view, state, frames), None

    def _search(self, image: Image, box: Box) -> tuple[MotionEstimate, _Answer]:
        before, memory = self._before, self._memory
        if before is None or memory is None:
            raise RuntimeError("the tracker was not started")
        output = self._network.predict(before.view, image, box, self._fill, memory, before.state)
        if not output.is_finite:  # and nothing of it is to be remembered
            return MotionEstimate(box, 0.0), _Answer(image, box, before.state)
        found = self._bounded(absolute_box(output.box, box), image)
        confidence = min(max(output.confidence, 0.0), 1.0) ** self._settings.confidence_power
        answer = _Answer(image, found, output.state)
        return MotionEstimate(found, confidence), answer

    def _bounded(self, box: Box, image: Image) -> Box:
        """Keep the centre on the image, and the sides neither tiny nor longer than the image's."""
        height, width = image.shape[:2]
        least = self._settings.smallest_side_px
        return Box(
            min(max(box.cx, 0.0), width),
            min(max(box.cy, 0.0), height),
            min(max(box.width, least), width),
            min(max(box.height, least), height),
        )
