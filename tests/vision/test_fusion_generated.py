"""What follows by default is honest: who is not there is not tracked, and is found on returning."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from follower_vision.detection import make_detector
from follower_vision.fusion import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.models import ModelStore
from follower_vision.trackers.registry import make_tracker
from follower_vision.trackers.track import Track, TrackState

RATE_HZ, SIZE = 30.0, (36, 24)
ORANGE, PILLAR = (30, 110, 240), (90, 100, 95)
Centre = tuple[float, float]
pytestmark = pytest.mark.slow


def draw_car(image: np.ndarray, centre: Centre) -> None:
    wide, tall = SIZE
    x, y = round(centre[0] - wide / 2), round(centre[1] - tall / 2)
    dark = tuple(channel // 4 for channel in ORANGE)
    cv2.rectangle(image, (x, y), (x + wide - 1, y + tall - 1), ORANGE, -1)
    cv2.rectangle(image, (x + 4, y + 3), (x + wide - 5, y + 9), dark, -1)
    for left, right in ((x, x + 7), (x + wide - 8, x + wide - 1)):
        cv2.rectangle(image, (left, y + tall - 5), (right, y + tall - 1), (20, 20, 20), -1)


def box_at(centre: Centre) -> Box:
    return Box(round(centre[0] - SIZE[0] / 2) + SIZE[0] / 2, centre[1], *SIZE)


def follow(
    seconds: float, target: Callable[[float], Centre | None], pillar: slice | None = None
) -> list[Track]:
    """Follow a car along a path over a textured ground, before a camera with noise."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(60, 150, (30, 40, 3), np.uint8)
    ground = cv2.resize(coarse, (400, 300), interpolation=cv2.INTER_CUBIC)
    store = ModelStore(Path())
    motion = make_tracker("siamese-correlation", store.file)
    tracker, tracks = FusionTracker(motion, make_detector("embedded", store)), []
    for index in range(round(seconds * RATE_HZ)):
        image, centre = ground.copy(), target(index / RATE_HZ)
        if centre is not None:
            draw_car(image, centre)
        if pillar is not None:
            image[:, pillar] = PILLAR
        noisy = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
        frame = Frame(noisy, index / RATE_HZ, index)
        if index == 0:
            assert centre is not None
            tracks.append(tracker.start(frame, box_at(centre)))
        else:
            tracks.append(tracker.step(frame))
    return tracks


def is_tracking(track: Track) -> bool:
    return track.state is TrackState.TRACKING


def first(tracks: list[Track], after_s: float, wanted: Callable[[Track], bool]) -> float:
    """Seconds from `after_s` until a track is as wanted; infinity if none is."""
    times = (t.captured_s - after_s for t in tracks if t.captured_s >= after_s and wanted(t))
    return next(times, math.inf)


def test_a_target_that_stays_in_view_is_tracked_all_the_time() -> None:
    def driving(time_s: float) -> Centre:
        return 80 + 40 * time_s, 120 + 10 * time_s

    tracks = follow(3.0, driving)
    assert all(map(is_tracking, tracks))
    assert min(t.box.iou(box_at(driving(t.captured_s))) for t in tracks) > 0.5


def test_a_target_that_vanishes_is_given_up_within_half_a_second() -> None:
    tracks = follow(3.5, lambda time_s: (120.0, 150.0) if time_s < 1.5 else None)
    assert first(tracks, 1.5, lambda t: not is_tracking(t)) < 0.5
    assert not any(is_tracking(t) for t in tracks if t.captured_s > 2.0)
    assert tracks[-1].state is TrackState.LOST
    assert tracks[-1].confidence < 0.5


def test_it_leaves_the_image_and_is_found_when_it_returns() -> None:
    def path(time_s: float) -> Centre:
        return (340 + 60 * time_s if time_s < 2.5 else 580 - 60 * (time_s - 1)), 150.0

    tracks = follow(6.5, path)
    assert not any(is_tracking(t) for t in tracks if 1.6 < t.captured_s < 3.3)
    # Its centre is back inside the image at 4 s, all of it at 4.3 s.
    assert first(tracks, 4.3, is_tracking) < 0.5
    assert tracks[-1].box.iou(box_at(path(tracks[-1].captured_s))) > 0.5


def test_it_passes_behind_a_pillar() -> None:
    def path(time_s: float) -> Centre:
        return 60 + 100 * time_s, 150.0

    tracks = follow(3.2, path, pillar=slice(190, 250))
    hidden = [t for t in tracks if 200 < path(t.captured_s)[0] < 240]
    assert TrackState.COASTING in {t.state for t in hidden}
    assert is_tracking(tracks[-1])
    right = [t for t in tracks if t.box.iou(box_at(path(t.captured_s))) > 0.5]
    assert len(right) > 0.75 * len(tracks)
