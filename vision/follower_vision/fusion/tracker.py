"""Fusion: one fitted probability chooses among what motion tracker and detector propose.

The parts are those of Panda and Barczyk, "Blending of Learning-based Tracking and Object Detection
for Monocular Camera-based Target Following" (IFAC 2019): a motion tracker, a detector every n-th
frame and on blurred frames, re-identification by correlation and colours. `paper.PaperFusion` is
their algorithm. Here their rules are replaced by a model that is fitted to many runs
(`follower train fusion`): it says of each candidate how probably it overlaps the target.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.appearance.blur import BlurDetector
from follower_vision.appearance.frame_check import FrameCheck, FrameHealth
from follower_vision.detection.detection import Detection, Detector
from follower_vision.detection.detection_service import (
    DetectionAnswer,
    DetectionMode,
    DetectionRequest,
    DetectionService,
    InlineDetection,
)
from follower_vision.fusion.box_filter import BoxFilter
from follower_vision.fusion.candidates import (
    PREDICTION,
    Candidate,
    agreed_box,
    corners_of,
    propose,
)
from follower_vision.fusion.descriptor import AppearanceMemory, describe
from follower_vision.fusion.embedder import make_embedder
from follower_vision.fusion.features import FEATURES, Situation, measure
from follower_vision.fusion.model import ProbabilityModel, model_for
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.target import SEEN, Target, log_sides
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.motion_tracker import (
    MotionTracker,
    OnePlaceResponse,
    ResponseMap,
    ResponseTracker,
)
from follower_vision.trackers.target_tracker import TargetPrediction
from follower_vision.trackers.track import Track, TrackState

Floats = npt.NDArray[np.floating]

AMBIGUOUS = "ambiguous"
_LEAST_VISIBLE = 0.1
_BELIEVED = 0.4
"""The prediction is taken only where nothing observed is as probable as this."""
_SURE = 0.7
_MOST_EVIDENCE = 20.0
"""Against a candidate, in log odds: of one that is certain, something is left."""
_FIRST_LESSONS = 3
"""The user's box counts as so many observations for what the detector sees of the target."""
_OTHERS_IOU = 0.5
_DEVIATION = FEATURES.index("deviation")


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen from in a frame; `follower train fusion` learns from it.

    Attributes:
        features: (N, F) of the candidates; see `FEATURES`.
        corners: (N, 4) left, top, right, bottom of them, in pixels.
        sources: where each is from.
        probabilities: (N, 3), see `ProbabilityModel`.
        chosen: index of the one that was taken.
    """

    features: Floats
    corners: Floats
    sources: tuple[str, ...]
    probabilities: Floats
    chosen: int


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """A frame that was searched, before the choice.

    Attributes:
        frame: the frame.
        response: the motion tracker's.
    """

    frame: Frame
    response: ResponseMap


class FusionTracker:
    """Follows one target through look-alikes, occlusion and absence; see `TargetTracker`.

    A track's confidence is P(IoU > 0.5), and its state follows from it. Its box is the mean of the
    candidates that agree with the chosen one, see `agreed_box`; where control foretells the target,
    the chosen one's own. `produced_by` is that one's source ("peak", "detection", "mean"), or why
    the target was not observed: "prediction", "frozen", "blank", or "ambiguous": what looks like it
    may be a known look-alike.

    Args:
        motion: searches each frame.
        detector: proposes candidates too; None does without.
        settings: see there.
        mode: `InlineDetection` or `BackgroundDetection`.
        model: None takes the settings' one.

    Attributes:
        listener: is told each choice; None is nobody.
        late_answers: what the newest step took of a detector that answers in its own time.

    Raises:
        ModelError: the settings' model cannot be used.
        PluginError: their embedder cannot be used.
    """

    def __init__(
        self,
        motion: MotionTracker,
        detector: Detector | None = None,
        settings: FusionSettings | None = None,
        mode: DetectionMode = InlineDetection,
        model: ProbabilityModel | None = None,
    ) -> None:
        self._motion = motion
        self._response = motion if isinstance(motion, ResponseTracker) else OnePlaceResponse(motion)
        self._settings = settings or FusionSettings()
        self._model = model or model_for(motion.name, self._settings.model)
        self._foretold = model or model_for(motion.name, self._settings.model, foretold=True)
        self._embedder = make_embedder(self._settings.embedder)
        self._service: DetectionService | None = None if detector is None else mode(detector)
        self._target: Target | None = None
        self._search: _Search | None = None
        self._prediction: TargetPrediction | None = None
        self._owner = object()
        self._companions: Sequence[FusionTracker] = ()
        self.listener: Callable[[Choice], None] | None = None
        self.late_answers: Sequence[DetectionAnswer] = ()

    def beside(self, companions: Sequence[FusionTracker]) -> None:
        """Leave other targets to the trackers that follow them through the same frames."""
        self._companions = companions

    def forget_requests(self) -> None:
        """Let the detector drop what it was asked for."""
        if self._service is not None:
            self._service.forget(self._owner)

    def close(self) -> None:
        """Release the threads."""
        if self._service is not None:
            self._service.close()

    def expect(self, prospect: TargetPrediction | None) -> None:
        """Take where the target can be in the next frame; see `AcceptsPrediction`."""
        self._prediction = prospect if self._settings.target_prediction else None

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
        self.forget_requests()  # answers under way belong to another target
        self._owner, self._prediction, self._search = object(), None, None
        self._health, self._blur = FrameCheck(), BlurDetector()
        self._health.update(frame)
        self._motion.start(frame.image, box)
        seen = self._response.search(frame.image, box).finite(box)
        memory = AppearanceMemory(describe(frame.image, [box], seen, self._embedder))
        size, now_s = log_sides(box), frame.captured_s
        filter_ = BoxFilter(self._model.noise, box)
        self._target = Target(filter_, box, size, memory, box, now_s, now_s)
        self._target.remember_box()
        self._ask(frame.image, self._target)
        return self.conclude(frame)

    def step(self, frame: Frame) -> Track:
        """Return the target's track in the next frame.

        Raises:
            RuntimeError: `start` was not called.
        """
        self.advance(frame)
        return self.conclude(frame)

    def advance(self, frame: Frame) -> None:
        """Do the first half of a step: predict, search, and ask the detector if it is due.

        Raises:
            RuntimeError: `start` was not called.
        """
        target = self._started()
        target.advance(frame.captured_s)
        self._take_prediction(target)
        target.filter.keep_within(frame.width, frame.height)
        health = self._health.update(frame)
        if health is not FrameHealth.GOOD:
            self._search = None
            target.coast(health.value)
            target.confidence = 0.0
            return
        expected = target.filter.box
        blurred = self._blur.update(frame.image, expected, frame.captured_s)
        place = expected
        if target.lost and target.index % 2 and target.other_place is not None:
            place = target.other_place
        response = self._response.search(frame.image, place).finite(place)
        self._search = _Search(frame, response)
        pause = self._settings.validate_every
        if blurred or target.probability < _SURE:
            pause = self._settings.doubt_every
        if target.index - target.asked >= pause:
            self._ask(frame.image, target)

    def conclude(self, frame: Frame) -> Track:
        """Do the second half of a step: take the detector's answers, and choose.

        Raises:
            RuntimeError: `start` was not called.
        """
        target = self._started()
        search, self._search = self._search, None
        # Answers wait while nothing is to be seen that they could be compared with.
        sees = search is not None or target.index == 0
        taken = self._service.take(self._owner) if self._service is not None and sees else []
        answers = [_finite(answer) for answer in taken]
        self.late_answers = () if isinstance(self._service, InlineDetection) else answers
        # Of a frame that is forgotten nobody knows how far its detections have moved since.
        known = [one for one in answers if target.remembers(one.request.index)]
        around = [one for one in known if one.request.index in target.around]
        aimed = [one for one in known if one.request.index not in target.around]
        if search is not None:
            self._choose(search, target, aimed)
            target.learn_look_alikes([one for answer in around for one in _present(answer, target)])
        for answer in answers:
            if answer.request.index == 0:
                for _ in range(_FIRST_LESSONS):
                    target.detector.learn(answer.detections, target.first_box, 1.0)
        target.remember_box()
        return target.track(frame)

    def put_back(self, box: Box) -> None:
        """Say for certain where the target was in the last frame, in pixels.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._started().place_at(box)

    @property
    def sure_box(self) -> Box | None:
        """Where the target is, in pixels; None if it was not observed."""
        target = self._target
        return target.box if target and target.state is TrackState.TRACKING else None

    def _started(self) -> Target:
        if self._target is None:
            raise RuntimeError("the tracker was not started")
        return self._target

    def _take_prediction(self, target: Target) -> None:
        """Take what control foretold for this frame."""
        known, self._prediction = self._prediction, None
        target.foreseen = known
        if known is not None:
            spread_px = max(known.likely.width, known.likely.height) / 4
            target.filter.expect(known.cx, known.cy, spread_px)

    def _ask(self, image: Image, target: Target) -> None:
        if self._service is None or not self._service.ready(urgent=target.lost):
            return
        target.asked = target.index
        target.looks += 1
        height, width = image.shape[:2]
        region = target.region_around(self._settings, width, height)
        if region is not None:
            target.around.add(target.index)
        else:
            region = target.detection_region(self._settings, width, height)
        self._service.submit(DetectionRequest(self._owner, target.index, image, region))

    def _choose(self, search: _Search, target: Target, answers: list[DetectionAnswer]) -> None:
        frame = search.frame
        detections = [one for answer in answers for one in _present(answer, target)]
        every = propose(search.response, detections, target.detector, target.filter.box)
        candidates = self._possible(every, target)
        boxes = [one.box for one in candidates]
        seen = describe(frame.image, boxes, search.response, self._embedder)
        situation = Situation(
            target, search.response, bool(answers), detections, frame.width, frame.height
        )
        features = measure(candidates, seen, situation)
        if target.foreseen is None:
            alone = probabilities = self._model.probabilities(features)
        else:
            misplaced = np.array([target.misplacement(box) for box in boxes])
            alone = doubted(self._foretold.probabilities(features), misplaced)
            # The last one is only where the target should be, and no look-alike.
            probabilities = doubted(alone, np.append(target.rivalry(boxes[:-1]), 0.0))
        chosen = best_candidate(candidates, probabilities)
        if self.listener is not None:
            sources = tuple(one.source for one in candidates)
            self.listener(Choice(features, corners_of(boxes), sources, probabilities, chosen))
        probability = float(probabilities[chosen, 1])
        target.believe(probability)
        if candidates[chosen].source == PREDICTION:
            target.coast(PREDICTION)
        else:
            target.observe(candidates[chosen], probability)
            if target.foreseen is None:  # in flights ranges are set by the chosen one's size
                target.reported = agreed_box(boxes[:-1], probabilities[:-1].sum(axis=1), chosen)
        rivalled = (alone[:-1, 1] >= SEEN) & (probabilities[:-1, 1] < SEEN)
        if target.state is not TrackState.TRACKING and rivalled.any():
            target.doubt(AMBIGUOUS)
        target.filter.keep_within(frame.width, frame.height)
        if target.state is TrackState.TRACKING:
            target.learn_size()
            target.learn_appearance(seen, chosen, probability)
            self._response.learn(frame.image, target.box, probability)
        if answers:
            target.learn_detections(detections, probability)
            target.learn_look_alikes(detections)
        unseen = target.state is not TrackState.TRACKING
        deviations = unseen * features[:, _DEVIATION]
        target.distractors.update(
            target.box, boxes[:-1], probabilities[:, 1], seen.features, deviations
        )

    def _possible(self, candidates: list[Candidate], target: Target) -> list[Candidate]:
        """Leave out what cannot be the target: where it cannot be, or another target."""
        observed = [one for one in candidates[:-1] if target.can_be_at(one.box)]
        others = [box for box in (one.sure_box for one in self._companions) if box is not None]
        expected = target.filter.box
        for other in others:
            observed = [
                one
                for one in observed
                if one.box.iou(other) < max(_OTHERS_IOU, one.box.iou(expected))
            ]
        return [*observed, candidates[-1]]


def doubted(probabilities: Floats, log_odds: Floats) -> Floats:
    """Return (N, 3) probabilities after evidence against N candidates, (N,) in log odds."""
    kept = probabilities * np.exp(-np.minimum(log_odds, _MOST_EVIDENCE))[:, None]
    return np.asarray(kept / (1.0 - probabilities + kept))


def best_candidate(candidates: Sequence[Candidate], probabilities: Floats) -> int:
    """Return the index of the candidate to take, by the sum of its (N, 3) probabilities.

    The prediction is taken only where nothing observed is probable: it is mostly right for a
    moment, and a track that follows it never sees its target again.
    """
    merit = probabilities.sum(axis=1)
    observed = [k for k, one in enumerate(candidates) if one.source != PREDICTION]
    best = max(observed, key=lambda k: float(merit[k]), default=None)
    if best is not None and probabilities[best, 1] >= _BELIEVED:
        return best
    return int(np.argmax(merit))


def _finite(answer: DetectionAnswer) -> DetectionAnswer:
    """Leave out detections whose score is no number."""
    detections = [one for one in answer.detections if math.isfinite(one.score)]
    return DetectionAnswer(answer.request, detections)


def _present(answer: DetectionAnswer, target: Target) -> list[Detection]:
    """Return an answer's detections, moved along with the target if they are of an older frame."""
    if answer.request.index == target.index:
        return answer.detections
    then = target.history[answer.request.index]
    now = target.filter.box
    right, down = now.cx - then.cx, now.cy - then.cy
    return [one.moved(right, down) for one in answer.detections]
