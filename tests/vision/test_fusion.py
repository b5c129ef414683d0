"""Fusion on generated sequences: a detector that thresholds colour, a real motion tracker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from follower_vision.box import Box
from follower_vision.correlation import CorrelationTracker
from follower_vision.detection.detection import Detection
from follower_vision.frame import Frame, Image
from follower_vision.fusion import FusionSettings, FusionTracker
from follower_vision.motion import MotionEstimate, MotionTracker
from follower_vision.prospect import Prospect
from follower_vision.track import Track, TrackState

WIDTH, HEIGHT, FPS = 480, 360, 30.0
SIDE = 36

Scene = Callable[[int], tuple[Image, tuple[float, float]]]
"""Draws a frame by its number, and tells where the target is in it."""


class ColourDetector:
    """Finds patches by their hue: red ones are "ball", blue ones "cone"."""

    class_names = ("ball", "cone")

    def __init__(self) -> None:
        self.regions: list[Box | None] = []

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        self.regions.append(region)
        blue, green, red = (image[..., channel].astype(int) for channel in range(3))
        masks = [(red > green + 60) & (red > blue + 60), (blue > green + 60) & (blue > red + 60)]
        found = [
            one for number, mask in enumerate(masks) for one in self._blobs(number, mask, region)
        ]
        return sorted(found, key=lambda one: -one.score)

    def _blobs(self, number: int, mask: np.ndarray, region: Box | None) -> list[Detection]:
        count, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
        boxes = [Box.from_xywh(*(float(v) for v in stats[i, :4])) for i in range(1, count)]
        return [
            Detection(box, number, self.class_names[number], 0.9)
            for box in boxes
            if box.area > 80 and (region is None or _within(box, region))
        ]


class TemplateTracker:
    """Finds the first image of the target again, by normalised cross-correlation nearby."""

    name = "template"

    def start(self, image: Image, box: Box) -> None:
        self._box = box
        left, top = round(box.left), round(box.top)
        self._template = image[top : top + round(box.height), left : left + round(box.width)].copy()

    def move_to(self, box: Box) -> None:
        self._box = box

    def update(self, image: Image) -> MotionEstimate:
        left = max(0, round(self._box.cx - 1.5 * self._box.width))
        top = max(0, round(self._box.cy - 1.5 * self._box.height))
        place = image[top : top + 3 * SIDE, left : left + 3 * SIDE]
        height, width = self._template.shape[:2]
        if place.shape[0] < height or place.shape[1] < width:
            return MotionEstimate(self._box, 0.0)
        found = cv2.matchTemplate(place, self._template, cv2.TM_CCOEFF_NORMED)
        _, confidence, _, (x, y) = cv2.minMaxLoc(found)
        self._box = Box.from_xywh(left + x, top + y, width, height)
        return MotionEstimate(self._box, max(0.0, min(1.0, confidence)))


def _within(box: Box, region: Box) -> bool:
    return region.left <= box.cx <= region.right and region.top <= box.cy <= region.bottom


def _texture(seed: int, height: int, width: int) -> Image:
    noise = np.random.default_rng(seed).uniform(40, 215, (height // 6, width // 6))
    grey = cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC).clip(0, 255)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


GROUND = _texture(1, 900, 1600)


def _paint(image: Image, x: float, y: float, seed: int, blue: bool = False) -> None:
    """Draw a textured patch of one hue, its middle at (x, y)."""
    patch = _texture(seed, SIDE, SIDE) // 3
    patch[..., 0 if blue else 2] += 160
    left, top = round(x - SIDE / 2), round(y - SIDE / 2)
    right, bottom = min(WIDTH, left + SIDE), min(HEIGHT, top + SIDE)
    if right > max(0, left) and bottom > max(0, top):
        cut = patch[max(0, -top) : bottom - top, max(0, -left) : right - left]
        image[max(0, top) : bottom, max(0, left) : right] = cut


def _ground(pan: float = 0.0) -> Image:
    left = round(400 + pan)
    return GROUND[200 : 200 + HEIGHT, left : left + WIDTH].copy()


def _frame(image: Image, number: int) -> Frame:
    return Frame(image, number / FPS, number)


def _box(x: float, y: float) -> Box:
    return Box(x, y, SIDE, SIDE)


def _fusion(detector: ColourDetector | None = None, **settings: object) -> FusionTracker:
    return FusionTracker(
        TemplateTracker(), detector or ColourDetector(), FusionSettings(**settings)
    )


def _crossing(number: int) -> tuple[Image, tuple[float, float]]:
    """Two identical balls run into each other and on."""
    image = _ground()
    x = 100 + 3.0 * number
    _paint(image, 400 - 3.0 * number, 190, 7)
    _paint(image, x, 180, 7)
    return image, (x, 180.0)


def _behind_wall(number: int) -> tuple[Image, tuple[float, float]]:
    """A ball runs behind a wall of 110 pixels and comes out again."""
    image = _ground()
    x = 90 + 3.0 * number
    _paint(image, x, 180, 7)
    image[100:260, 220:330] = 90
    return image, (x, 180.0)


def _ball_that_leaves(number: int) -> tuple[Image, tuple[float, float]]:
    """A ball lies there for a second, and then no more."""
    image = _ground()
    if number < 30:
        _paint(image, 200.0, 180.0, 7)
    return image, (200.0, 180.0)


def _run(tracker: FusionTracker, scene: Scene, count: int) -> list[tuple[Track, float]]:
    """Follow a scene; return each track with its overlap with the truth."""
    image, place = scene(0)
    tracker.start(_frame(image, 0), _box(*place))
    answers = []
    for number in range(1, count):
        image, place = scene(number)
        track = tracker.step(_frame(image, number))
        answers.append((track, track.box.iou(_box(*place))))
    return answers


def test_follows_a_target_that_the_detector_knows() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground()
        place = (150 + 2.0 * number, 150 + 1.0 * number)
        _paint(image, *place, 7)
        return image, place

    answers = _run(_fusion(), scene, 60)
    assert min(overlap for _, overlap in answers) > 0.6
    assert {track.state for track, _ in answers} == {TrackState.TRACKING}
    assert "detector" in {track.produced_by for track, _ in answers}


def test_keeps_identity_when_a_twin_crosses() -> None:
    answers = _run(_fusion(), _crossing, 95)
    assert np.mean([overlap > 0.5 for _, overlap in answers[-20:]]) == 1.0


def test_finds_the_target_again_behind_a_wall() -> None:
    answers = _run(_fusion(), _behind_wall, 120)
    hidden = [track.state for track, _ in answers[60:70]]
    assert TrackState.TRACKING not in hidden
    assert min(overlap for _, overlap in answers[-15:]) > 0.5


def test_wrong_box_is_never_called_tracking_after_the_target_has_left() -> None:
    answers = _run(_fusion(), _ball_that_leaves, 90)
    assert {track.state for track, _ in answers[60:]} == {TrackState.LOST}


def test_returns_to_a_target_that_reappears_elsewhere() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground()
        place = (120.0, 120.0) if number < 40 else (350.0, 250.0)
        if number < 30 or number >= 70:
            _paint(image, *place, 7)
        return image, place

    answers = _run(_fusion(), scene, 100)
    assert min(overlap for _, overlap in answers[-15:]) > 0.5
    assert any(track.produced_by == "reacquired" for track, _ in answers)


@pytest.mark.parametrize(("motion", "frames"), [(TemplateTracker, 75), (CorrelationTracker, 47)])
@pytest.mark.parametrize("before", [_crossing, _behind_wall, _ball_that_leaves])
def test_a_tracker_that_begins_anew_is_like_a_new_one(
    motion: Callable[[], MotionTracker], before: Scene, frames: int
) -> None:
    """Whatever it went through: lost, in doubt, with a look-alike, or in the middle of that."""
    used, new = (FusionTracker(motion(), ColourDetector()) for _ in range(2))
    _run(used, before, frames)
    assert _run(used, _behind_wall, 100) == _run(new, _behind_wall, 100)


class LooseDetector(ColourDetector):
    """A small network: in the whole image, reduced to its size, its boxes are far off."""

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        found = super().detect(image, region)
        if region is not None and region.width <= 10 * SIDE:
            return found
        return [replace(one, box=_loose(one.box)) for one in found]


def _loose(box: Box) -> Box:
    return Box(box.cx + 0.3 * box.width, box.cy - 0.5 * box.height, 1.3 * box.width, box.height)


def test_looks_closer_at_what_may_be_the_lost_target() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground()
        place = (120.0, 120.0) if number < 40 else (350.0, 250.0)
        if number < 30 or number >= 90:
            _paint(image, *place, 7)
        return image, place

    detector = LooseDetector()
    answers = _run(_fusion(detector), scene, 110)
    assert all(overlap > 0.5 for _, overlap in answers[98:])
    closer = [region for region in detector.regions[-12:] if region is not None]
    assert any(region.distance(_box(350.0, 250.0)) < SIDE for region in closer)


class NearsightedDetector(ColourDetector):
    """A small network that sees a small target in an enlarged region only."""

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        found = super().detect(image, region)
        return found if region is not None and region.width <= 5 * SIDE else []


@pytest.mark.parametrize("stands_out", [True, False])
def test_a_small_target_is_found_far_from_where_it_was_lost_long_ago(
    stands_out: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground() + np.random.default_rng(number).integers(
            0, 9, (HEIGHT, WIDTH, 1), np.uint8
        )
        place = (90.0, 90.0) if number < 100 else (400.0, 290.0)
        if number < 30 or number >= 170:
            _paint(image, *place, 7)
        return image, place

    if not stands_out:
        monkeypatch.setattr("follower_vision.fusion.looks.Looks.proposals", lambda *_: [])
    answers = _run(_fusion(NearsightedDetector()), scene, 270)
    assert {track.state for track, _ in answers[60:165]} == {TrackState.LOST}
    within_s = 1.0 if stands_out else 3.0
    assert all(overlap > 0.5 for _, overlap in answers[170 + round(within_s * FPS) :])


def test_does_not_take_another_class_for_the_target() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground()
        if number < 30:
            _paint(image, 200.0, 180.0, 7)
        _paint(image, 300.0, 180.0, 7, blue=True)
        return image, (200.0, 180.0)

    answers = _run(_fusion(), scene, 90)
    assert {track.state for track, _ in answers[60:]} == {TrackState.LOST}


def test_validation_looks_at_a_zoomed_crop_and_the_paper_at_the_whole_image() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground()
        _paint(image, 200.0 + number, 180.0, 7)
        return image, (200.0 + number, 180.0)

    detector, whole = ColourDetector(), ColourDetector()
    _run(_fusion(detector), scene, 30)
    _run(FusionTracker(TemplateTracker(), whole, FusionSettings.paper()), scene, 30)
    assert all(region is not None and region.width >= 128 for region in detector.regions[:3])
    assert set(whole.regions) == {None}


def _foreseen(place: tuple[float, float], likely_px: float = 60.0) -> Prospect:
    region = Box(*place, likely_px, likely_px)
    return Prospect(*place, region, region.scaled(2.0))


def _hidden_beside_a_twin(number: int) -> tuple[Image, tuple[float, float]]:
    """A ball is hidden for a second and a half; its twin walks by, 110 pixels away, meanwhile."""
    image = _ground()
    place = (150.0 + number, 180.0)
    _paint(image, *place, 7)
    if 40 <= number < 85:
        image[120:240, 140:270] = 90
    if number >= 45:
        _paint(image, 400 - 3.0 * (number - 45), 290, 7)
    return image, place


@pytest.mark.parametrize("told", [True, False])
def test_a_twin_is_not_taken_where_the_target_cannot_be(told: bool) -> None:
    """Who knows where the target is to come out waits for it there."""
    tracker, wrong, last = _fusion(), 0, 0.0
    tracker.start(_frame(_hidden_beside_a_twin(0)[0], 0), _box(*_hidden_beside_a_twin(0)[1]))
    for number in range(1, 110):
        image, place = _hidden_beside_a_twin(number)
        tracker.expect(_foreseen(place) if told else None)
        track = tracker.step(_frame(image, number))
        last = track.box.iou(_box(*place))
        wrong += track.confidence > 0.5 and last == 0
    if told:
        assert wrong == 0
        assert track.state is TrackState.TRACKING
        assert last > 0.6
    else:
        assert wrong > 0  # nothing in the picture tells them apart


class LeapingTracker(TemplateTracker):
    """Goes over to a place far away in one image, as sure as ever."""

    def __init__(self, leaps: int) -> None:
        super().__init__()
        self._left = leaps

    def update(self, image: Image) -> MotionEstimate:
        self._left -= 1
        if self._left == 0:
            self.move_to(_box(430, 300))
        return super().update(image)


def test_a_tracker_that_leaps_to_a_twin_is_called_back_at_once() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image, place = _ground(), (200.0 + number, 180.0)
        _paint(image, *place, 7)
        _paint(image, 430, 300, 7)
        return image, place

    tracker = FusionTracker(LeapingTracker(25))
    tracker.start(_frame(scene(0)[0], 0), _box(*scene(0)[1]))
    for number in range(1, 60):
        image, place = scene(number)
        tracker.expect(_foreseen(place))
        track = tracker.step(_frame(image, number))
        assert track.state is not TrackState.TRACKING or track.box.iou(_box(*place)) > 0.5
    assert track.state is TrackState.TRACKING


def test_prospects_can_be_switched_off_and_hold_for_one_frame() -> None:
    far = _foreseen((500.0, 330.0))
    for settings, frames in (({"prospects": False}, range(1, 20)), ({}, [])):
        tracker = _fusion(**settings)
        tracker.start(_frame(_steady(0)[0], 0), _box(*_steady(0)[1]))
        for number in range(1, 20):
            image, place = _steady(number)
            if number in frames or number == 5:
                tracker.expect(far)
            track = tracker.step(_frame(image, number))
        assert track.state is TrackState.TRACKING
        assert track.box.iou(_box(*place)) > 0.6


def test_is_the_same_every_time() -> None:
    first = [track for track, _ in _run(_fusion(), _crossing, 60)]
    second = [track for track, _ in _run(_fusion(), _crossing, 60)]
    assert first == second


def test_a_swinging_camera_does_not_lose_a_standing_target() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        pan = 120 * np.sin(number / 6)
        image = _ground(pan)
        _paint(image, 240 - pan, 180.0, 7)
        return image, (float(240 - pan), 180.0)

    answers = _run(_fusion(), scene, 90)
    assert np.mean([overlap > 0.5 for _, overlap in answers]) > 0.95


def test_needs_a_start_within_the_image() -> None:
    tracker = _fusion()
    with pytest.raises(RuntimeError):
        tracker.step(_frame(_ground(), 0))
    with pytest.raises(ValueError, match="outside"):
        tracker.start(_frame(_ground(), 0), Box(-100, -100, 20, 20))


def test_unfamiliar_target_is_followed_by_the_motion_tracker_alone() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground()
        x, y = 150 + 2 * number, 170
        image[y - 18 : y + 18, x - 18 : x + 18] = _texture(99, 36, 36) // 2 + 90
        return image, (float(x), float(y))

    answers = _run(_fusion(), scene, 60)
    assert min(overlap for _, overlap in answers) > 0.5
    assert {track.produced_by for track, _ in answers} == {"template"}


def _steady(number: int) -> tuple[Image, tuple[float, float]]:
    image, place = _ground(), (150.0 + number, 180.0)
    _paint(image, *place, 7)
    return image, place


def test_a_steady_target_is_validated_less_often() -> None:
    often, steady = ColourDetector(), ColourDetector()
    _run(_fusion(often, validate_steady_every=4), _steady, 120)
    _run(_fusion(steady, validate_steady_every=12), _steady, 120)
    assert len(often.regions) == 30
    assert len(steady.regions) <= 14


def test_a_target_that_the_detector_never_knew_is_not_asked_for_again() -> None:
    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image = _ground()
        image[160:196, 132 + number : 168 + number] = _texture(99, 36, 36) // 2 + 90
        return image, (150.0 + number, 178.0)

    detector = ColourDetector()
    _run(_fusion(detector), scene, 120)
    assert len(detector.regions) < 12


def test_a_sure_tracker_is_not_believed_where_the_detector_sees_nothing() -> None:
    """From frame 60 on a grey thing of the same pattern stands for the ball."""

    def scene(number: int) -> tuple[Image, tuple[float, float]]:
        image, place = _steady(number)
        if number >= 60:
            image = np.repeat(image.max(axis=2, keepdims=True), 3, axis=2)
        return image, place

    answers = _run(_fusion(), scene, 110)
    assert {track.state for track, _ in answers[:55]} == {TrackState.TRACKING}
    assert TrackState.TRACKING not in {track.state for track, _ in answers[64:]}


@pytest.mark.parametrize(
    "wrong",
    [
        {"validate_every": 0},
        {"validate_steady_every": 0},
        {"match_iou": 1.5},
        {"coast_s": 0.0},
        {"size_least": 1.5},
        {"size_change_found": 0.5},
    ],
)
def test_settings_refuse_nonsense(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="fusion"):
        FusionSettings(**wrong)


def test_every_improvement_can_be_switched_off() -> None:
    paper = FusionSettings.paper()
    assert paper.reidentify.max_recent == 0
    assert FusionSettings().without("camera_motion").camera_motion is False
    with pytest.raises(ValueError, match="camera_motion"):
        FusionSettings().without("luck")


class HesitantGuide:
    """Knows where the target is, and is less sure of it from its twentieth image on."""

    name = "guide"

    def __init__(self) -> None:
        self.updates = 0

    def start(self, image: Image, box: Box) -> None:
        """Nothing to learn."""

    def move_to(self, box: Box) -> None:
        """Nowhere to be sent."""

    def update(self, _image: Image) -> MotionEstimate:
        self.updates += 1
        return MotionEstimate(_box(100 + 3 * self.updates, 150), 1.0 if self.updates < 20 else 0.9)


def test_a_confident_tracker_is_followed_though_nobody_knows_its_box_any_more() -> None:
    """Where the looks changed for good there is no better guess; but it is not called seen."""
    tracker = FusionTracker(HesitantGuide())
    states = []
    for number in range(120):
        image = _ground()
        _paint(image, 100 + 3 * number, 150, 3 if number < 20 else 9, blue=number >= 20)
        if number == 0:
            tracker.start(_frame(image, number), _box(100, 150))
        else:
            track = tracker.step(_frame(image, number))
            states.append(track.state)
            assert track.box.iou(_box(100 + 3 * number, 150)) > 0.9
    tracker.close()
    assert TrackState.TRACKING not in states[25:]
    assert states[-1] is TrackState.LOST
