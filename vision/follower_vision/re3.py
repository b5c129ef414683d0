"""Re3: a recurrent network that says where the box of the last frame has gone."""

from __future__ import annotations

from dataclasses import dataclass

import cv2

from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.motion import MotionEstimate
from follower_vision.re3_geometry import absolute_box
from follower_vision.re3_network import Re3Memory, Re3Network, Re3State
from follower_vision.re3_settings import Re3Settings

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
    """What the network said of an image.

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
    Tracking of Generic Objects" (RA-L 2018); docs/training.md lists where the network departs.

    It can be sent elsewhere: what it saw last, what it remembers and where it looks are three
    things. However often it looks at one image, the next image counts as the next frame, and what
    it saw last is where its last look found the target.
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

    @property
    def frames_since_reset(self) -> int:
        """How many frames the LSTM layers remember, the first one not counted."""
        return 0 if self._before is None else self._before.frames

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`, (H, W, 3) uint8 BGR."""
        self._fill = tuple(cv2.mean(image)[:3])
        box = self._bounded(box, image)
        self._memory, self._first_state = self._network.learn(image, box, self._fill)
        self._go_on_from(image, box)

    def move_to(self, box: Box) -> None:
        """Search about `box` next time, without learning the target anew.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._started()
        self._box = box

    def correct(self, image: Image, box: Box) -> None:
        """Go on from where the target is in `image`, without learning it anew.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._started()
        self._go_on_from(image, self._bounded(box, image))

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR.

        The same image object is the same frame: then it looks once more.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._remember_last(image)
        estimate, self._answer = self._look(image, self._started())
        self._box = estimate.box
        return estimate

    def probe(self, image: Image, box: Box) -> list[MotionEstimate]:
        """Look for the target about another box, and tell the place without going there.

        Raises:
            RuntimeError: `start` was not called.
        """
        return [self._look(image, box)[0]]

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

    def _look(self, image: Image, box: Box) -> tuple[MotionEstimate, _Answer]:
        before, memory = self._before, self._memory
        if before is None or memory is None:
            raise RuntimeError("the tracker was not started")
        said = self._network.look(before.view, image, box, self._fill, memory, before.state)
        found = self._bounded(absolute_box(said.box, box), image)
        confidence = said.confidence**self._settings.confidence_power
        answer = _Answer(image, found, said.state)
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
