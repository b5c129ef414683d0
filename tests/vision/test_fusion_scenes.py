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
from follower_vision.trackers.motion_tracker import IdentityTracker
from follower_vision.trackers.registry import make_tracker
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import Track, TrackState

RATE_HZ = 30.0
SIZE = (36, 24)
ORANGE = (30, 110, 240)
STORE = ModelStore(pathlib.Path())
Path = Callable[[float], tuple[float, float] | None]


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
    """A textured ground, a car on it, and a camera with noise."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        coarse = self._rng.integers(60, 150, (30, 40, 3), np.uint8)
        self._ground = cv2.resize(coarse, (400, 300), interpolation=cv2.INTER_CUBIC)

    def frame(self, index: int, centre: tuple[float, float] | None) -> Frame:
        image = self._ground.copy()
        if centre is not None:
            draw_car(image, centre)
        noisy = image + self._rng.normal(0, 3, image.shape)
        return Frame(np.clip(noisy, 0, 255).astype(np.uint8), index / RATE_HZ, index)


def draw_car(image, centre):
    w, h = SIZE
    x, y = round(centre[0] - w / 2), round(centre[1] - h / 2)
    dark = tuple(channel // 4 for channel in ORANGE)
    cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), ORANGE, -1)
    cv2.rectangle(image, (x + 4, y + 3), (x + w - 5, y + 9), dark, -1)
    cv2.rectangle(image, (x, y + h - 5), (x + 7, y + h - 1), (20, 20, 20), -1)
    cv2.rectangle(image, (x + w - 8, y + h - 5), (x + w - 1, y + h - 1), (20, 20, 20), -1)


def box_at(centre: tuple[float, float]) -> Box:
    return Box(round(centre[0] - SIZE[0] / 2) + SIZE[0] / 2, centre[1], *SIZE)


def follow(
    tracker: TargetTracker,
    seconds: float,
    target: Path,
) -> list[Track]:
    """Track a target along a path."""
    scene, tracks = Scene(), []
    for index in range(round(seconds * RATE_HZ)):
        time_s = index / RATE_HZ
        frame = scene.frame(index, target(time_s))
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
@pytest.mark.parametrize("tracker", [alone(CorrelationTracker), usual])
def test_it_passes_behind_a_pillar(tracker):
    """The Siamese tracker finds it with a detector alone."""
    scene, follower = Scene(), tracker()
    states, right = [], 0
    for index in range(96):
        centre = (60 + 100 * index / RATE_HZ, 150.0)
        frame = scene.frame(index, centre)
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
