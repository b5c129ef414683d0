"""Re3: a recurrent network that says where the box of the last frame has gone."""

from __future__ import annotations

import cv2

from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.motion import MotionEstimate
from follower_vision.re3_geometry import absolute_box
from follower_vision.re3_network import Re3Memory, Re3Network, Re3Output, Re3State
from follower_vision.re3_settings import Re3Settings

NO_SETTINGS = Re3Settings()


class Re3Tracker:
    """Follows a box by our Re3 network.

    After Gordon, Farhadi and Fox, "Re3: Real-Time Recurrent Regression Networks for Visual
    Tracking of Generic Objects" (RA-L 2018); docs/training.md lists where the network departs.

    It is no `SteerableTracker`: its answer depends on the frames before, which is its point. Fusion
    starts it anew where a detection corrects it, as the paper does.
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
        self._state: Re3State = self._first_state
        self._fill: tuple[float, ...] = ()
        self._image: Image | None = None
        self._box: Box | None = None
        self._frames = 0

    @property
    def frames_since_reset(self) -> int:
        """How many frames the LSTM layers remember, the first one not counted."""
        return self._frames

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`, (H, W, 3) uint8 BGR."""
        self._fill = tuple(cv2.mean(image)[:3])
        box = self._bounded(box, image)
        self._memory, self._first_state = self._network.learn(image, box, self._fill)
        self._state = self._first_state
        self._image, self._box = image, box
        self._frames = 0

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._box is None or self._image is None or self._memory is None:
            raise RuntimeError("the tracker was not started")
        self._forget_in_time()
        output = self._network.look(
            self._image, image, self._box, self._fill, self._memory, self._state
        )
        self._take(output, image, self._box)
        return MotionEstimate(self._box, output.confidence**self._settings.confidence_power)

    def _forget_in_time(self) -> None:
        if self._frames >= self._settings.reset_frames:
            self._state = self._first_state
            self._frames = 0

    def _take(self, output: Re3Output, image: Image, last: Box) -> None:
        self._box = self._bounded(absolute_box(output.box, last), image)
        self._state = output.state
        self._image = image
        self._frames += 1

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
