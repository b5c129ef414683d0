"""What Fusion knows of its target from frame to frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from follower_vision.detection.detection import Detection
from follower_vision.detection.detectors import parts
from follower_vision.fusion.box_filter import BoxFilter
from follower_vision.fusion.candidates import Candidate, DetectorMemory
from follower_vision.fusion.descriptor import AppearanceMemory, Descriptors
from follower_vision.fusion.distractors import Distractors
from follower_vision.fusion.look_alikes import LookAlikes, Sightings
from follower_vision.fusion.settings import FusionSettings
from follower_vision.geometry.box import Box, lies_in
from follower_vision.geometry.camera_model import CameraView
from follower_vision.images.frame import Frame
from follower_vision.trackers.target_tracker import (
    MotionForecast,
    TargetPrediction,
)
from follower_vision.trackers.track import Track, TrackState

Floats = npt.NDArray[np.floating]

SEEN = 0.5
"""From this P(IoU > 0.5) on the target counts as observed."""
_LOST_CONFIDENCE = 0.4
"""A prediction is a guess by then."""
_COAST_S = 0.4
_AGAIN_S = 0.2
"""Two frames so close together that show a lost target are no chance: every other one is looked at
by the detector."""
_MEAN_TIME_S = 0.65
_SIZE_TIME_S = 1.1
_JUMP_SIGMA = 4.0
"""An observation so many standard deviations away is a new start, not a measurement."""
_LEAST_PROBABILITY = 0.05
_KEPT_FRAMES = 64
_REGION_SIZES = 2.5
_REGION_SIGMA = 6.0
_WIDER = 2.5
_LIKELY_S = 3.0
"""So long a target that is not seen is taken only where control says that it mostly is."""
FORMERLY_S = 1.2
"""What control believed so long ago may know of the target what was lost since."""
_APART_SIZES = 1.5
_LEAST_DENSITY = 1e-20
_APART_IOU = 0.3
_KIN_SCORE, _KIN_SHARE = 0.3, 0.05
"""So sure is the detector of a look-alike, and so often has it taken the target for the same."""
_RATHER_KNOWN = math.log(2)
"""From so much evidence on a thing is rather a known look-alike than something new."""
_LOOK_AROUND, _LOOK_AROUND_UNSEEN = 2, 3
"""Each so many looks one is for look-alikes, where they can be remembered."""


@dataclass(slots=True)
class Target:
    """The state of a target that is followed.

    Attributes:
        filter: predicts the box.
        first_box: at the start, pixels.
        usual_size: log of width and height, (2,), as confirmed over the last second.
        memory: how it looks.
        box: in the last frame, pixels, of the filter's size: what is learnt from.
        captured_s: time of the last frame.
        seen_s: time of the last frame in which it was observed.
        detector: what the detector sees of it.
        distractors: what was seen beside it.
        look_alikes: the same in the world, where that is known.
        size_px_m: the scale of its box at 1 m, pixels times metres; None before it is known.
        probability: P(IoU > 0.5) of the last choice.
        glimpsed_s: time of the last frame that showed it probably enough.
        mean_probability: the same over the last second.
        confidence: what is told of the box: the probability, 0 where a frame showed nothing.
        state: of the track.
        produced_by: what the box is from.
        index: number of the frame, from 0 at the start.
        asked: index of the frame that the detector was last asked about.
        looks: how often it was asked.
        around: indices of the frames in which it was asked for look-alikes.
        foreseen: where control expects it in the frame; None where control knows nothing.
        other_place: where something like the target was detected while it is lost, pixels.
        history: the box by index, for the answers of a detector in the background.
        reported: the box as it was seen: sizes err slowly, so that a filter only makes them late.
    """

    filter: BoxFilter
    first_box: Box
    usual_size: Floats
    memory: AppearanceMemory
    box: Box
    captured_s: float
    seen_s: float
    detector: DetectorMemory = field(default_factory=DetectorMemory)
    distractors: Distractors = field(default_factory=Distractors)
    look_alikes: LookAlikes = field(default_factory=LookAlikes)
    size_px_m: float | None = None
    probability: float = 1.0
    glimpsed_s: float = -math.inf
    mean_probability: float = 1.0
    confidence: float = 1.0
    state: TrackState = TrackState.TRACKING
    produced_by: str = "start"
    index: int = 0
    asked: int = 0
    looks: int = 0
    around: set[int] = field(default_factory=set)
    foreseen: TargetPrediction | None = None
    other_place: Box | None = None
    interval_s: float = 0.0
    history: dict[int, Box] = field(default_factory=dict)
    reported: Box = field(init=False)

    def __post_init__(self) -> None:
        self.reported = self.box

    @property
    def lost(self) -> bool:
        """Whether it was not observed for longer than a track may coast."""
        return self.state is TrackState.LOST

    @property
    def view(self) -> CameraView | None:
        """How the camera sees the world, where look-alikes can be remembered; None elsewhere."""
        return None if self.foreseen is None or self.size_px_m is None else self.foreseen.view

    def advance(self, captured_s: float) -> None:
        """Predict to the next frame's time, in seconds."""
        self.index += 1
        self.interval_s = max(captured_s - self.captured_s, 1e-3)
        self.captured_s = max(captured_s, self.captured_s)
        self.filter.predict(self.interval_s)
        self.distractors.predict(self.interval_s)
        self.look_alikes.predict(self.interval_s)

    def place_at(self, box: Box) -> None:
        """Take a box in the last frame, in pixels, for certain; all that was learnt stays."""
        self.filter.place_at(box)
        self.box, self.reported, self.state = box, box, TrackState.TRACKING
        self.probability = self.confidence = 1.0
        self.seen_s = self.captured_s
        self.history[self.index] = box

    def observe(self, winner: Candidate, probability: float) -> None:
        """Take a candidate for the target, in proportion to its P(IoU > 0.5)."""
        seen, box = self._is_seen(probability), winner.box
        expected, sigma = self.filter.box, self.filter.deviations
        away = math.hypot((box.cx - expected.cx) / sigma[0], (box.cy - expected.cy) / sigma[1])
        if seen and away > _JUMP_SIGMA:
            self.filter.place_at(Box(box.cx, box.cy, expected.width, expected.height))
        self.filter.observe(box, winner.source, max(probability, _LEAST_PROBABILITY))
        filtered = self.filter.box
        self.reported, self.produced_by = box, winner.source
        if probability >= SEEN:
            self.glimpsed_s = self.captured_s
        if not seen:
            self.box = filtered
            self.state = self._unseen_state()
            return
        self.box = Box(box.cx, box.cy, filtered.width, filtered.height)
        self.seen_s, self.state = self.captured_s, TrackState.TRACKING
        rate = 1 - math.exp(-self.interval_s / _SIZE_TIME_S)
        self.usual_size = self.usual_size + rate * probability * (
            log_sides(self.box) - self.usual_size
        )

    def coast(self, why: str) -> None:
        """Take the prediction for the target, and say why."""
        self.box = self.reported = self.filter.box
        self.produced_by = why
        self.state = self._unseen_state()
        if self.lost:  # however well the prediction fits, nobody has seen the target for long
            self.doubt(why)

    def doubt(self, why: str) -> None:
        """Call the box a guess, and say why."""
        self.produced_by, self.confidence = why, min(self.confidence, _LOST_CONFIDENCE)

    def _is_seen(self, probability: float) -> bool:
        """Whether a choice of this P(IoU > 0.5) is the target.

        In a flight a lost one is so in the second frame that says so: a wrong one misleads control.
        """
        again = self.captured_s - self.glimpsed_s <= _AGAIN_S
        return probability >= SEEN and (again or not self.lost or self.foreseen is None)

    def believe(self, probability: float) -> None:
        """Remember the P(IoU > 0.5) of the frame's choice."""
        self.probability = self.confidence = probability
        rate = 1 - math.exp(-self.interval_s / _MEAN_TIME_S)
        self.mean_probability += rate * (probability - self.mean_probability)

    def learn_detections(self, detections: list[Detection], probability: float) -> None:
        """Compare what the detector saw with where the target is."""
        if probability >= SEEN:
            self.detector.learn(detections, self.box, probability)
            self.other_place = None
        elif detections:
            self.other_place = self._other_place(detections)

    def _other_place(self, detections: list[Detection]) -> Box | None:
        """Return the likeliest of what was detected, in pixels; None if all are look-alikes."""
        against = self.rivalry([self.detector.corrected(one) for one in detections])
        others = [
            one for one, odds in zip(detections, against, strict=True) if odds < _RATHER_KNOWN
        ]
        likeliest = max(
            others,
            key=lambda one: one.score * (0.1 + self.detector.class_share(one)),
            default=None,
        )
        return None if likeliest is None else self.detector.corrected(likeliest)

    def learn_look_alikes(self, detections: list[Detection]) -> None:
        """Remember what else of the target's kind the detector saw."""
        boxes = [
            self.detector.corrected(one)
            for one in detections
            if one.score >= _KIN_SCORE and self.detector.class_share(one) >= _KIN_SHARE
        ]
        seen = self.state is TrackState.TRACKING
        apart = [box for box in boxes if self.lost or box.iou(self.box) < _APART_IOU]
        places = self.sightings(apart)
        if places is not None:
            self.look_alikes.update(places, self.probability if seen else 0.0)
        here = self.sightings([self.box]) if seen else None
        if here is not None:
            self.look_alikes.leave(here)

    def learn_appearance(self, seen: Descriptors, row: int, probability: float) -> None:
        """Remember how the chosen candidate looks."""
        self.memory.learn(seen, row, probability)

    def detection_region(self, settings: FusionSettings, width: int, height: int) -> Box | None:
        """Return where the detector looks: about the prediction, wider with its uncertainty.

        A square on a coarse grid, so that runs that differ a little ask for the same region and an
        evaluation can keep the answers. While the target is lost every third one is larger. Where
        control formerly foretold another place, every second one is there.

        Args:
            settings: the usual region.
            width: of the image, in pixels.
            height: of the image, in pixels.

        Returns:
            The region in pixels; None is the whole image.
        """
        box = self.filter.box
        elsewhere = self._formerly_foreseen(box)
        if elsewhere is not None and self.looks // 2 % 2:
            box = elsewhere
        sizes = max(settings.crop_sizes, _REGION_SIZES + _REGION_SIGMA * self.filter.spread)
        side = max(box.scale * sizes, settings.crop_least_px)
        if self.lost and (self.index // settings.doubt_every) % 3 == 2:
            side *= _WIDER
        if side >= max(width, height):
            return None
        side = 2.0 ** (math.ceil(math.log2(side) * 4) / 4)
        step = side / 8
        return Box(round(box.cx / step) * step, round(box.cy / step) * step, side, side)

    def region_around(self, settings: FusionSettings, width: int, height: int) -> Box | None:
        """Return where to look for look-alikes now, in pixels; None if for the target.

        Later nobody can tell them apart. What is known is looked at in turn with parts of the image
        in which something new may be.

        Args:
            settings: the usual region.
            width: of the image, in pixels.
            height: of the image, in pixels.
        """
        view, size = self.view, self.size_px_m
        seen = self.state is TrackState.TRACKING
        pause = _LOOK_AROUND if seen else _LOOK_AROUND_UNSEEN
        if view is None or size is None or self.looks % pause:
            return None
        turn = self.looks // pause
        sought = None if seen and turn % 2 == 0 else self.look_alikes.sought(view)
        if sought is not None:
            place, range_m = sought
            side = max(settings.crop_sizes * size / range_m, settings.crop_least_px)
            return Box(*place, side, side)
        if not seen:
            return None
        every = tuple(parts(width, height))
        return every[(turn // 2 + turn % 2 * len(every) // 2) % len(every)]

    def can_be_at(self, box: Box) -> bool:
        """Whether the target can be where a box is, in pixels, by what control foretells."""
        known, margin_px = self.foreseen, box.scale / 2
        if known is None:
            return True
        unseen_s = self.captured_s - self.seen_s
        waits = self.state is not TrackState.TRACKING and unseen_s <= _LIKELY_S
        regions = [known.likely if waits else known.possible]
        if self._formerly_foreseen(self.filter.box) is not None:
            regions += [one.likely for one in self._former_forecasts()]
        return any(lies_in(box, region, margin_px) for region in regions)

    def deviations(self, box: Box) -> tuple[float, float]:
        """Return how many standard deviations a box is from where control foretells the target.

        The nearest forecast counts of those that were made so long ago that they may know better.

        Returns:
            by what is believed now, and by what was believed before; 0 where nothing is foretold.
        """
        if self.foreseen is None:
            return 0.0, 0.0
        before = (_deviations(box, one) for one in self._former_forecasts())
        return _deviations(box, self.foreseen), min(before, default=0.0)

    def misplacement(self, box: Box) -> float:
        """Return what a box's place says against it by what control foretells, in log odds.

        A look-alike shows what the target would; only its place is another. What is followed may
        have become a look-alike a moment ago, and foretell its own way: the forecasts from before
        that count. A target that is not seen leads nothing astray, the newest counts, too: it is
        where any of the forecasts says, a mixture of normal distributions.
        """
        if self.foreseen is None:
            return 0.0
        every: list[TargetPrediction | MotionForecast] = [*self._former_forecasts()]
        seen = self.state is TrackState.TRACKING
        if not seen and self._formerly_foreseen(self.filter.box) is None:
            every.append(self.foreseen)
        if not every:
            return 0.0
        densities = [1 / (one.likely.width * one.likely.height) for one in every]
        here = [
            density * math.exp(-0.5 * _deviations(box, one) ** 2)
            for density, one in zip(densities, every, strict=True)
        ]
        return math.log(sum(densities)) - math.log(max(sum(here), _LEAST_DENSITY))

    def rivalry(self, boxes: Sequence[Box]) -> Floats:
        """Return what speaks against N boxes by the look-alikes they may be, in log odds, (N,)."""
        seen = self.sightings(boxes)
        return np.zeros(len(boxes)) if seen is None else self.look_alikes.evidence(boxes, seen)

    def sightings(self, boxes: Sequence[Box]) -> Sightings | None:
        """Return where in the world boxes are, in pixels; None where that is not known."""
        view, size = self.view, self.size_px_m
        if view is None or size is None or not boxes:
            return None
        return Sightings.of(boxes, view, size)

    def learn_size(self) -> None:
        """Remember how large it looks at its distance, if that is known."""
        seen = math.nan if self.foreseen is None else self.box.scale * self.foreseen.range_m
        if 0 < seen < math.inf:
            rate = 1 - math.exp(-self.interval_s / _SIZE_TIME_S)
            before = seen if self.size_px_m is None else self.size_px_m
            self.size_px_m = before + rate * (seen - before)

    def remembers(self, index: int) -> bool:
        """Whether it is known where the target was in a frame, or it is this one."""
        return index in self.history or index == self.index

    def remember_box(self) -> None:
        """Keep the frame's box for detections that come late."""
        self.history[self.index] = self.box
        self.history.pop(self.index - _KEPT_FRAMES, None)
        self.around.discard(self.index - _KEPT_FRAMES)

    def track(self, frame: Frame) -> Track:
        """Return the track in a frame."""
        confidence = min(max(self.confidence, 0.0), 1.0)
        return Track(
            self.reported,
            self.state,
            confidence,
            self.produced_by,
            frame.captured_s,
            frame.sequence,
        )

    def _former_forecasts(self) -> list[MotionForecast]:
        earlier = () if self.foreseen is None else self.foreseen.earlier
        return [one for one in earlier if self.captured_s - one.since_s > FORMERLY_S]

    def _formerly_foreseen(self, expected: Box) -> Box | None:
        """Where it should be by what was believed before, if that is elsewhere."""
        forecasts = self._former_forecasts()
        if not forecasts:
            return None
        cx, cy = np.mean([[one.cx, one.cy] for one in forecasts], axis=0).tolist()
        place = expected.moved_to(cx, cy)
        return place if place.distance(expected) > _APART_SIZES * expected.scale else None

    def _unseen_state(self) -> TrackState:
        coasting = self.captured_s - self.seen_s <= _COAST_S
        return TrackState.COASTING if coasting else TrackState.LOST


def _deviations(box: Box, forecast: TargetPrediction | MotionForecast) -> float:
    """What is likely is two standard deviations wide, on each side: nearer to us they are more."""
    right, down, likely = box.cx - forecast.cx, box.cy - forecast.cy, forecast.likely
    across_px = likely.right - forecast.cx if right > 0 else forecast.cx - likely.left
    along_px = likely.bottom - forecast.cy if down > 0 else forecast.cy - likely.top
    return 2 * math.hypot(right / max(across_px, 1.0), down / max(along_px, 1.0))


def log_sides(box: Box) -> Floats:
    """Return the logs of a box's width and height in pixels, (2,)."""
    return np.array([math.log(box.width), math.log(box.height)])
