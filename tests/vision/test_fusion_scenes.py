"""Fusion in drawn scenes: what is not there is not tracked, and is followed when it returns."""

import math
import pathlib
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from follower_vision.detection import make_detector
from follower_vision.fusion import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.models import ModelStore
from follower_vision.trackers.correlation import CorrelationTracker
from follower_vision.trackers.motion_tracker import IdentityTracker, MotionEstimate
from follower_vision.trackers.registry import make_tracker
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import Track, TrackState

RATE_HZ = 30.0
SIZE = (36, 24)
ORANGE, BLUE = (30, 110, 240), (220, 120, 30)
Path = Callable[[float], tuple[float, float] | None]


class TemplateTracker:
    """A real, if simple, motion tracker: the best match near the last place."""

    name = "template"

    def start(self, image, box):
        self._box = box
        self._template = self._cut(image, box)

    def update(self, image):
        region = self._box.scaled(3.0)
        x, y = max(0, round(region.left)), max(0, round(region.top))
        place = image[y : round(region.bottom), x : round(region.right)]
        tall, wide = self._template.shape[:2]
        if place.shape[0] < tall or place.shape[1] < wide:
            return MotionEstimate(self._box, 0.0)
        match = cv2.matchTemplate(place, self._template, cv2.TM_CCOEFF_NORMED)
        _, value, _, (right, down) = cv2.minMaxLoc(match)
        self._box = self._box.moved_to(x + right + wide / 2, y + down + tall / 2)
        return MotionEstimate(self._box, max(0.0, value) if math.isfinite(value) else 0.0)

    @staticmethod
    def _cut(image, box):
        x, y = max(0, round(box.left)), max(0, round(box.top))
        return image[y : round(box.bottom), x : round(box.right)].copy()


TRACKERS = [TemplateTracker, CorrelationTracker]


STORE = ModelStore(pathlib.Path())


def alone(motion) -> Callable[[], TargetTracker]:
    """Return what makes Fusion of a motion tracker without a detector."""
    return lambda: FusionTracker(motion())


def siamese():
    return make_tracker("siamese-correlation", STORE.file)


def usual() -> TargetTracker:
    """Return what `follower track` follows with."""
    return FusionTracker(siamese(), make_detector("embedded", STORE))


FOLLOWERS = [alone(CorrelationTracker), alone(siamese), usual]


class Scene:
    """A textured ground, cars on it, and a camera with noise."""

    def __init__(self, seed: int = 0, width: int = 400, height: int = 300) -> None:
        self._rng = np.random.default_rng(seed)
        coarse = self._rng.integers(60, 150, (height // 10, width // 10, 3), np.uint8)
        self._ground = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)

    def frame(self, index: int, *cars: tuple[tuple[float, float] | None, tuple]) -> Frame:
        image = self._ground.copy()
        for centre, colour in cars:
            if centre is not None:
                draw_car(image, centre, colour)
        noisy = image + self._rng.normal(0, 3, image.shape)
        return Frame(np.clip(noisy, 0, 255).astype(np.uint8), index / RATE_HZ, index)

    def black(self, index: int) -> Frame:
        noise = np.abs(self._rng.normal(0, 2, self._ground.shape))
        return Frame(noise.astype(np.uint8), index / RATE_HZ, index)


def draw_car(image, centre, colour):
    w, h = SIZE
    x, y = round(centre[0] - w / 2), round(centre[1] - h / 2)
    dark = tuple(channel // 4 for channel in colour)
    cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), colour, -1)
    cv2.rectangle(image, (x + 4, y + 3), (x + w - 5, y + 9), dark, -1)
    cv2.rectangle(image, (x, y + h - 5), (x + 7, y + h - 1), (20, 20, 20), -1)
    cv2.rectangle(image, (x + w - 8, y + h - 5), (x + w - 1, y + h - 1), (20, 20, 20), -1)


def box_at(centre: tuple[float, float]) -> Box:
    return Box(round(centre[0] - SIZE[0] / 2) + SIZE[0] / 2, centre[1], *SIZE)


def follow(
    tracker: TargetTracker,
    seconds: float,
    target: Path,
    other: Path = lambda _: None,
    seed: int = 0,
) -> list[Track]:
    """Track a target along a path beside a look-alike of another colour."""
    scene, tracks = Scene(seed), []
    for index in range(round(seconds * RATE_HZ)):
        time_s = index / RATE_HZ
        frame = scene.frame(index, (other(time_s), BLUE), (target(time_s), ORANGE))
        step = tracker.step if index else lambda frame: tracker.start(frame, box_at(target(0.0)))
        tracks.append(step(frame))
    return tracks


def first(tracks: list[Track], after_s: float, wanted: Callable[[Track], bool]) -> float:
    """Seconds from `after_s` until a track is as wanted; infinity if none is."""
    times = (t.captured_s - after_s for t in tracks if t.captured_s >= after_s and wanted(t))
    return next(times, math.inf)


def driving(time_s: float) -> tuple[float, float]:
    return 80 + 40 * time_s, 120 + 10 * time_s


def is_tracking(track: Track) -> bool:
    return track.state is TrackState.TRACKING


@pytest.mark.slow
@pytest.mark.parametrize("tracker", FOLLOWERS)
def test_a_target_that_stays_in_view_is_tracked_all_the_time(tracker):
    tracks = follow(tracker(), 3.0, driving)
    assert all(map(is_tracking, tracks))
    assert min(t.box.iou(box_at(driving(t.captured_s))) for t in tracks) > 0.6
    assert min(t.confidence for t in tracks) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("tracker", [alone(siamese), usual, alone(IdentityTracker)])
def test_a_target_that_vanishes_is_given_up_within_half_a_second(tracker):
    """The correlation filter alone takes bare ground for it again, now and then."""

    def path(time_s):
        return (120.0, 150.0) if time_s < 1.5 else None

    tracks = follow(tracker(), 3.5, path)
    assert first(tracks, 1.5, lambda t: not is_tracking(t)) < 0.5
    assert not any(is_tracking(t) for t in tracks if t.captured_s > 2.0)
    assert tracks[-1].state is TrackState.LOST
    assert tracks[-1].confidence < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("tracker", FOLLOWERS)
def test_it_leaves_the_image_and_returns(tracker):
    def path(time_s):
        return (340 + 60 * time_s if time_s < 2.5 else 580 - 60 * (time_s - 1), 150.0)

    tracks = follow(tracker(), 6.5, path)
    away = [t for t in tracks if 1.6 < t.captured_s < 3.3]
    assert not any(map(is_tracking, away))
    # Its centre is back inside the image at 4 s, all of it at 4.3 s.
    assert first(tracks, 4.3, is_tracking) < 0.5
    assert tracks[-1].box.iou(box_at(path(tracks[-1].captured_s))) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("tracker", [*map(alone, TRACKERS), usual])
def test_it_passes_behind_a_pillar(tracker):
    """The Siamese tracker finds it with a detector alone."""
    scene, follower = Scene(), tracker()
    states, right = [], 0
    for index in range(96):
        centre = (60 + 100 * index / RATE_HZ, 150.0)
        frame = scene.frame(index, (centre, ORANGE))
        image = frame.image.copy()
        image[:, 190:250] = (90, 100, 95)
        frame = Frame(image, frame.captured_s, index)
        track = follower.step(frame) if index else follower.start(frame, box_at(centre))
        hidden = 200 < centre[0] < 240
        if hidden:
            states.append(track.state)
        right += track.box.iou(box_at(centre)) > 0.5
    assert TrackState.COASTING in states
    assert is_tracking(track)
    assert right > 75


@pytest.mark.parametrize("tracker", TRACKERS)
def test_black_frames_are_no_sighting(tracker):
    scene, fusion = Scene(), FusionTracker(tracker())
    fusion.start(scene.frame(0, ((100.0, 100.0), ORANGE)), box_at((100.0, 100.0)))
    for index in range(1, 30):
        assert is_tracking(fusion.step(scene.frame(index, ((100.0, 100.0), ORANGE))))
    dark = [fusion.step(scene.black(index)) for index in range(30, 60)]
    assert not any(map(is_tracking, dark))
    assert {t.produced_by for t in dark} == {"blank"}
    assert dark[-1].state is TrackState.LOST
    after = [fusion.step(scene.frame(i, ((100.0, 100.0), ORANGE))) for i in range(60, 75)]
    assert is_tracking(after[-1])


def test_frames_out_of_order_do_not_end_it():
    """They come from the past, half of them with the target and half without."""
    scene, fusion = Scene(), FusionTracker(CorrelationTracker())
    fusion.start(scene.frame(60, ((100.0, 100.0), ORANGE)), box_at((100.0, 100.0)))
    for index in range(61, 90):
        fusion.step(scene.frame(index, ((100.0, 100.0), ORANGE)))
    for index in (*range(90, 110), 40, 41):
        assert not is_tracking(fusion.step(scene.black(index)))
    for index in (*range(10, 20), *range(120, 135)):
        after = fusion.step(scene.frame(index, ((100.0, 100.0), ORANGE)))
    assert is_tracking(after)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_frozen_picture_is_no_sighting(tracker):
    scene, fusion = Scene(), FusionTracker(tracker())
    fusion.start(scene.frame(0, ((100.0, 100.0), ORANGE)), box_at((100.0, 100.0)))
    frozen = scene.frame(1, ((101.0, 100.0), ORANGE)).image
    tracks = [fusion.step(Frame(frozen, i / RATE_HZ, i)) for i in range(1, 60)]
    doubt = [t for t in tracks if t.captured_s > 0.2]
    assert {t.state for t in doubt} == {TrackState.COASTING, TrackState.LOST}
    assert {t.confidence for t in doubt} == {0.0}
    assert {t.produced_by for t in doubt} == {"frozen"}
    assert doubt[-1].state is TrackState.LOST


def test_one_repeated_frame_is_not_yet_frozen():
    scene, fusion = Scene(), FusionTracker(TemplateTracker())
    fusion.start(scene.frame(0, ((100.0, 100.0), ORANGE)), box_at((100.0, 100.0)))
    for index in range(1, 40):
        frame = scene.frame(index, ((100.0, 100.0), ORANGE))
        assert is_tracking(fusion.step(frame))
        twice = Frame(frame.image, frame.captured_s + 0.01, index)
        assert is_tracking(fusion.step(twice))


def test_coasting_goes_on_at_the_speed_in_pixels_a_second():
    """Half the frame rate makes no difference to where a hidden target is expected."""
    ends = []
    for stride in (1, 2):
        scene, fusion = Scene(), FusionTracker(TemplateTracker())
        frames = [
            scene.frame(i, ((80 + 3.0 * i, 150.0) if i < 46 else None, ORANGE)) for i in range(52)
        ]
        fusion.start(frames[0], box_at((80.0, 150.0)))
        tracks = [fusion.step(frame) for frame in frames[stride::stride]]
        ends.append(next(t for t in tracks if t.sequence == 50))
    assert [t.state for t in ends] == [TrackState.COASTING] * 2
    assert ends[0].box.cx == pytest.approx(ends[1].box.cx, abs=6)
    assert ends[0].box.cx > 80 + 3.0 * 46


def test_choosing_again_forgets_the_first_target():
    scene, fusion = Scene(), FusionTracker(TemplateTracker())
    cars = (((100.0, 100.0), ORANGE), ((300.0, 200.0), BLUE))
    fusion.start(scene.frame(0, *cars), box_at((100.0, 100.0)))
    fusion.step(scene.frame(1, *cars))
    fusion.start(scene.frame(2, *cars), box_at((300.0, 200.0)))
    track = fusion.step(scene.frame(3, *cars))
    assert is_tracking(track)
    assert track.box.iou(box_at((300.0, 200.0))) > 0.6
    assert (track.captured_s, track.sequence) == (3 / RATE_HZ, 3)


@pytest.mark.slow
def test_the_same_frames_give_the_same_tracks():
    def path(time_s):
        return driving(time_s) if time_s < 1 else None if time_s < 1.8 else (300.0, 60.0)

    once, again = (follow(FusionTracker(CorrelationTracker()), 3.0, path) for _ in range(2))
    assert once == again


def test_a_box_outside_the_image_is_refused():
    scene, fusion = Scene(), FusionTracker(IdentityTracker())
    with pytest.raises(ValueError, match="outside the image of 400 x 300"):
        fusion.start(scene.frame(0), Box(500, 100, 20, 20))


def test_stepping_before_a_start_is_an_error():
    with pytest.raises(RuntimeError, match="not started"):
        FusionTracker(IdentityTracker()).step(Scene().frame(0))
