"""Fusion: follows one target by a motion tracker that a detector validates."""

from __future__ import annotations

from collections.abc import Sequence

from follower_vision.box import Box
from follower_vision.detection.detection import Detector
from follower_vision.embedding import Embedder
from follower_vision.frame import Frame
from follower_vision.framecheck import FrameHealth
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.camera_motion import CameraMotion
from follower_vision.fusion.detection_service import (
    DetectionAnswer,
    DetectionMode,
    DetectionRequest,
    DetectionService,
    InlineDetection,
    Need,
)
from follower_vision.fusion.evidence import CERTAIN
from follower_vision.fusion.finding import Finding
from follower_vision.fusion.following import Following
from follower_vision.fusion.history import Moment
from follower_vision.fusion.identity import Identity
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.preparation import Preparation
from follower_vision.fusion.regions import Regions
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.validation import Validation
from follower_vision.motion import MotionTracker
from follower_vision.prospect import Prospect, has_middle
from follower_vision.track import Track, TrackState

_LEAST_VISIBLE = 0.1


class FusionTracker:
    """Follows one target through look-alikes, occlusion and absence; see `TargetTracker`.

    After Panda and Barczyk, "Blending of Learning-based Tracking and Object Detection for
    Monocular Camera-based Target Following" (IFAC 2019), with the improvements of `FusionSettings`.

    `produced_by` is the motion tracker's name, "detector" (validated in this frame),
    "reacquired", or why the target was not seen: "coasting", "frozen", "blank", "lost".
    """

    def __init__(
        self,
        motion: MotionTracker,
        detector: Detector | None = None,
        settings: FusionSettings | None = None,
        mode: DetectionMode = InlineDetection,
        camera: CameraMotion | None = None,
        embedder: Embedder | None = None,
    ) -> None:
        """Make a tracker that waits for `start`.

        Args:
            motion: follows the box between validations.
            detector: validates and finds again; without one every target is unfamiliar.
            settings: see there.
            mode: `InlineDetection` or `BackgroundDetection`.
            camera: measures the camera's motion; trackers of one video may share it.
            embedder: an appearance network that helps to find the target among its kind.
        """
        self._settings = settings or FusionSettings()
        self._service: DetectionService | None = None if detector is None else mode(detector)
        self._name = motion.name
        self._looks = Looks(self._settings.reidentify, embedder)
        self._following = Following(motion, self._settings, self._looks)
        self._validation = Validation(self._settings, self._following, self._looks)
        self._finding = Finding(self._settings, self._following, self._validation, self._looks)
        self._identity = Identity(self._settings)
        self._preparation = Preparation(self._settings, self._following, camera)
        self._belief: Belief | None = None
        self._regions = Regions(self._settings, self._finding, self._looks)
        self._asked = self._looks_taken = 0
        self._prospect: Prospect | None = None
        self._pursuit = object()
        self._companions: Sequence[FusionTracker] = ()

    def beside(self, companions: Sequence[FusionTracker]) -> None:
        """Leave other targets to the trackers that follow them through the same frames."""
        self._companions = companions

    def close(self) -> None:
        """Let go of the threads."""
        self._preparation.close()
        if self._service is not None:
            self._service.close()

    def expect(self, prospect: Prospect | None) -> None:
        """Take where the target can be in the next frame; see `Foresighted`."""
        self._prospect = prospect if self._settings.prospects else None

    def start(self, frame: Frame, box: Box) -> Track:
        """Choose the target: what `box` shows in `frame`. Everything earlier is forgotten.

        Raises:
            ValueError: less than a tenth of the box lies inside the image.
        """
        if box.visible_share(frame.width, frame.height) < _LEAST_VISIBLE:
            raise ValueError(
                f"the target's box (x {box.left:.0f}, y {box.top:.0f}, {box.width:.0f} x "
                f"{box.height:.0f}) lies outside the image of {frame.width} x {frame.height}"
            )
        self._forget()
        self._preparation.start(frame)
        self._looks.start(frame, box)
        self._following.start(frame, box)
        self._belief = Belief(frame, box, self._name)
        self._ask(frame, self._belief)
        return self.conclude(frame)

    def step(self, frame: Frame) -> Track:
        """Return the target's track in the next frame.

        Raises:
            RuntimeError: `start` was not called.
        """
        self.advance(frame)
        return self.conclude(frame)

    def advance(self, frame: Frame) -> None:
        """Do the first half of a step: follow, and ask for a detection if it is time for one.

        Raises:
            RuntimeError: `start` was not called.
        """
        belief = self._started()
        held = [one._held() for one in self._companions]
        belief.taken = [box for box in held if box is not None]
        interval_s = frame.captured_s - belief.now.captured_s
        belief.expect(self._prospect, frame.captured_s)
        self._prospect = None
        seen = self._preparation.prepare(frame, belief)
        expected = belief.advance(frame.captured_s, seen.warp, self._settings.camera_motion)
        if not self._following.doubting:
            expected = belief.foresee(expected)
        if seen.health is not FrameHealth.GOOD:
            self._following.coast(frame, belief, expected, seen.health.value)
        else:
            self._follow(frame, belief, expected, interval_s, seen.blurred)
        belief.now.box = belief.box

    def conclude(self, frame: Frame) -> Track:
        """Do the second half of a step: take in what the detector has answered.

        Raises:
            RuntimeError: `start` was not called.
        """
        belief = self._started()
        for answer in [] if self._service is None else self._service.take(self._pursuit):
            moment = belief.history.at(answer.request.index)
            if moment is not None:
                self._consider(frame, belief, answer, moment)
        belief.now.box = belief.box
        return belief.track(frame)

    def _held(self) -> Box | None:
        """Where the target is; None if that is not sure."""
        belief = self._started()
        return belief.box if belief.state is TrackState.TRACKING else None

    def _started(self) -> Belief:
        if self._belief is None:
            raise RuntimeError("the tracker was not started")
        return self._belief

    def _forget(self) -> None:
        self._validation.start()
        self._finding.forget()
        self._identity = Identity(self._settings)
        self._regions.start()
        self._asked = self._looks_taken = 0
        self._prospect = None
        # Answers that are still under way belong to another pursuit.
        if self._service is not None:
            self._service.forget(self._pursuit)
        self._pursuit = object()

    def _follow(
        self, frame: Frame, belief: Belief, expected: Box, interval_s: float, blurred: bool
    ) -> None:
        self._following.follow(frame, belief, expected, interval_s, blurred)
        lost = belief.state is TrackState.LOST and not self._following.doubting
        if lost and not belief.familiar:
            self._finding.unaided(frame, belief, expected)
        need = self._need(belief, blurred)
        if self._is_due(belief, need, blurred):
            self._ask(frame, belief, need)

    def _is_due(self, belief: Belief, need: Need, blurred: bool) -> bool:
        if self._identity.strange:
            return False
        return belief.now.index - self._asked >= self._pause(belief, need, blurred)

    def _need(self, belief: Belief, blurred: bool) -> Need:
        if belief.state is not TrackState.TRACKING:
            return Need.URGENT if belief.state is TrackState.LOST else Need.DOUBTFUL
        settings = self._settings
        low = settings.score_coasting and belief.confidence < settings.resume_ratio
        odd = settings.appearance_check and belief.witness.wonders
        if blurred or low or odd or self._validation.suspects(belief):
            return Need.DOUBTFUL
        steady = belief.confidence >= CERTAIN and self._validation.steady
        return Need.STEADY if steady else Need.USUAL

    def _pause(self, belief: Belief, need: Need, blurred: bool) -> int:
        """How many frames lie between two looks."""
        settings = self._settings
        if blurred and belief.state is TrackState.TRACKING:
            return settings.validate_blurred_every
        if need is Need.STEADY:
            return settings.validate_steady_every
        return settings.validate_every if need is Need.USUAL else settings.search_every

    def _ask(self, frame: Frame, belief: Belief, need: Need = Need.USUAL) -> None:
        if self._service is None or not self._service.ready(need):
            return
        self._asked = belief.now.index
        self._looks_taken += 1
        elsewhere = self._validation.elsewhere(belief, self._looks_taken)
        region = self._regions.next(frame, belief, elsewhere)
        self._service.submit(DetectionRequest(self._pursuit, self._asked, frame.image, region))

    def _consider(
        self, frame: Frame, belief: Belief, answer: DetectionAnswer, moment: Moment
    ) -> None:
        certain = belief.state is TrackState.TRACKING and belief.confidence > 0.9
        region = answer.request.region
        covered = region is None or has_middle(region, moment.box)
        if certain and covered:
            self._identity.meet(answer.detections, moment)
            belief.familiar = self._identity.familiar
        if not belief.familiar:
            return
        sight = self._identity.sight(answer.detections, moment)
        seen = any(box.iou(moment.box) >= self._settings.match_iou for box in sight.boxes)
        if covered:
            belief.witness.testify(seen, certain)
        if belief.state is TrackState.LOST:
            self._finding.among(frame, belief, sight, answer.request.image)
        else:
            self._validation.validate(frame, belief, sight, answer.request.image, covered)
