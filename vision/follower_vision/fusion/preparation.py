"""What Fusion learns of a frame before it looks for the target: can it be seen, has it moved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from follower_vision.blur import BlurDetector
from follower_vision.box import Box
from follower_vision.frame import Frame, Image
from follower_vision.framecheck import FrameCheck, FrameHealth
from follower_vision.fusion.aside import Aside
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.camera_motion import CameraMotion
from follower_vision.fusion.evidence import SURE
from follower_vision.fusion.following import Following
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.warp import Warp
from follower_vision.track import TrackState


@dataclass(frozen=True, slots=True)
class Prepared:
    """What is known of a frame before the target is looked for.

    Attributes:
        health: whether there is anything to be seen.
        warp: the camera's motion from the last frame.
        blurred: whether the neighbourhood of the target's last place is blurred.
    """

    health: FrameHealth
    warp: Warp
    blurred: bool


class Preparation:
    """Measures the camera's motion and blur in a second thread while the tracker looks ahead.

    Where the camera moves evenly and the tracker is sure of what it sees, neither is measured in
    every frame. Where the tracker looked at the wrong place the last time, it is not run ahead. The
    boxes are the same whichever thread is the quicker one.
    """

    def __init__(
        self, settings: FusionSettings, following: Following, camera: CameraMotion | None
    ) -> None:
        """Make one that waits for `start`; trackers of one video may share a camera."""
        self._settings = settings
        self._following = following
        self._camera = camera or CameraMotion()
        self._blur = BlurDetector(settings.blur)
        self._blurred = False
        self._health = FrameCheck()
        self._aside: Aside[Prepared] = Aside(self._camera.seek)

    def close(self) -> None:
        """Let go of the thread."""
        self._aside.close()

    def start(self, frame: Frame) -> None:
        """Forget everything and take a first frame."""
        self._camera.reset()
        self._blur.reset()
        self._blurred = False
        self._health = FrameCheck()
        self._health.update(frame)
        self._camera.update(frame.image)

    def prepare(self, frame: Frame, belief: Belief) -> Prepared:
        """Prepare a frame; `belief` is still that of the last one."""
        if not self._settings.camera_motion:
            health = self._health.update(frame)
            blurred = self._is_blurred(frame, frame.image, belief.box, health)
            return Prepared(health, Warp(), blurred)
        sure = belief.state is TrackState.TRACKING and belief.confidence >= SURE
        if sure and self._camera.foreseeable(frame.image, [belief.box]):
            if self._following.look_ahead(frame, belief):
                warp = self._camera.foresee(frame.image)
                return Prepared(self._health.update(frame), warp, self._blurred)
            prepared = self._measure(frame, belief.box)
        elif self._following.looks_ahead_in_vain:
            prepared = self._measure(frame, belief.box)
        else:
            self._aside.begin(partial(self._measure, frame, belief.box))
            self._following.look_ahead(frame, belief)
            prepared = self._aside.end()
        self._blurred = prepared.blurred
        return prepared

    def _measure(self, frame: Frame, box: Box) -> Prepared:
        """Learn what does not depend on where the target is found; `box` is of the last frame."""
        warp = self._camera.update(frame.image, [box])
        health = self._health.update(frame)
        image = frame.image if self._camera.grey is None else self._camera.grey
        return Prepared(health, warp, self._is_blurred(frame, image, warp.box(box), health))

    def _is_blurred(self, frame: Frame, image: Image, box: Box, health: FrameHealth) -> bool:
        if health is not FrameHealth.GOOD:
            return False
        return self._blur.update(image, box, frame.captured_s).blurred
