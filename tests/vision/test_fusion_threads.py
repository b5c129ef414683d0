"""Fusion's threads change when things are worked out, never what comes out; no frame waits."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from follower_vision.box import Box
from follower_vision.detection.detection import Detection
from follower_vision.frame import Frame, Image
from follower_vision.fusion import BackgroundDetection, FusionSettings, FusionTracker
from follower_vision.fusion.aside import Aside
from follower_vision.fusion.camera_motion import CameraMotion
from follower_vision.fusion.warp import Warp
from follower_vision.motion import MotionEstimate
from follower_vision.track import Track

WIDTH, HEIGHT = 640, 360
WAIT_S = 10.0


def _textured(seed: int, height: int, width: int) -> Image:
    noise = np.random.default_rng(seed).integers(0, 255, (height // 8, width // 8, 3), np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


GROUND = _textured(1, 900, 1600)


def _seen(right: float, down: float, turned: float = 0.0, zoom: float = 1.0) -> Image:
    """The ground from a camera that looks elsewhere, pixels and radians."""
    cosine, sine = np.cos(turned) / zoom, np.sin(turned) / zoom
    matrix = np.array([[cosine, -sine, 480 + right], [sine, cosine, 270 + down]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(GROUND, matrix, (WIDTH, HEIGHT), flags=flags)


def _scene(number: int) -> Frame:
    """A camera that swings and a target that runs."""
    image = _seen(60 * np.sin(number / 4), 20 * np.cos(number / 3))
    left = 100 + 4 * number
    image[150:190, left : left + 40] = _textured(7, 40, 40)
    return Frame(image, number / 30, number)


class Matcher:
    """Finds the target's first picture again near the place that it was sent to."""

    name = "matcher"

    def __init__(self) -> None:
        self.updates = 0

    def start(self, image: Image, box: Box) -> None:
        self._box = box
        left, top = round(box.left), round(box.top)
        self._picture = image[top : top + 40, left : left + 40].copy()

    def move_to(self, box: Box) -> None:
        self._box = box

    def update(self, image: Image) -> MotionEstimate:
        self.updates += 1
        left = int(np.clip(round(self._box.cx) - 60, 0, WIDTH - 120))
        top = int(np.clip(round(self._box.cy) - 60, 0, HEIGHT - 120))
        place = image[top : top + 120, left : left + 120]
        found = cv2.matchTemplate(place, self._picture, cv2.TM_CCOEFF_NORMED)
        _, confidence, _, (x, y) = cv2.minMaxLoc(found)
        self._box = Box.from_xywh(left + x, top + y, 40, 40)
        return MotionEstimate(self._box, max(0.0, confidence))


class StuckDetector:
    """Answers only when it is allowed to."""

    class_names = ("thing",)

    def __init__(self) -> None:
        self.may_answer = threading.Event()
        self.begun = threading.Semaphore(0)
        self.calls = 0
        self.niceness = 0

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        self.calls += 1
        if sys.platform == "linux":
            self.niceness = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
        self.begun.release()
        assert self.may_answer.wait(WAIT_S)
        return []


def _tracks(tracker: FusionTracker, count: int = 50) -> list[Track]:
    tracks = [tracker.start(_scene(0), Box(120, 170, 40, 40))]
    tracks += [tracker.step(_scene(number)) for number in range(1, count)]
    tracker.close()
    return tracks


def test_every_frame_is_answered_while_the_detector_never_answers() -> None:
    """If a step waited for the detection, the detector's own assertion would stop this test."""
    detector = StuckDetector()
    tracker = FusionTracker(Matcher(), detector, mode=BackgroundDetection)
    tracker.start(_scene(0), Box(120, 170, 40, 40))
    assert detector.begun.acquire(timeout=WAIT_S)
    for number in range(1, 50):
        assert tracker.step(_scene(number)).sequence == number
    assert detector.calls == 1, "requests must not queue up behind a slow detector"
    detector.may_answer.set()
    tracker.close()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has priorities of threads")
def test_the_detector_lets_the_tracker_go_first() -> None:
    detector = StuckDetector()
    service = BackgroundDetection(detector)
    tracker = FusionTracker(Matcher(), detector, mode=lambda _: service)
    tracker.start(_scene(0), Box(120, 170, 40, 40))
    assert detector.begun.acquire(timeout=WAIT_S)
    assert detector.niceness > os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    detector.may_answer.set()
    tracker.close()


_LEAVES_AT_ONCE = """
import time
import numpy as np
from follower_vision.fusion import BackgroundDetection
from follower_vision.fusion.detection_service import DetectionRequest

class Slow:
    class_names = ()
    def detect(self, image, region=None):
        began.append(1)
        time.sleep(0.3)
        print("finished")
        return []

began = []
service = BackgroundDetection(Slow())
service.submit(DetectionRequest(1, 0, np.zeros((8, 8, 3), np.uint8), None))
while not began:
    time.sleep(0.01)
"""


def test_a_program_that_ends_lets_the_detection_finish() -> None:
    """A thread that is cut off inside a network ends the program with an abort."""
    left = subprocess.run(
        [sys.executable, "-c", _LEAVES_AT_ONCE], capture_output=True, text=True, timeout=30
    )
    assert (left.returncode, left.stdout) == (0, "finished\n")


class AtOnce(Aside[object]):
    """Does the work when it is begun."""

    def begin(self, work: Callable[[], object]) -> None:
        self.done = work()

    def end(self) -> object:
        return self.done


class AtLast(Aside[object]):
    """Does the work when its result is asked for."""

    def begin(self, work: Callable[[], object]) -> None:
        self.work = work

    def end(self) -> object:
        return self.work()


@pytest.mark.parametrize("aside", [AtOnce, AtLast])
def test_which_thread_is_the_quicker_one_changes_no_track(
    monkeypatch: pytest.MonkeyPatch, aside: type[Aside[object]]
) -> None:
    threaded = _tracks(FusionTracker(Matcher()))
    monkeypatch.setattr("follower_vision.fusion.preparation.Aside", aside)
    assert _tracks(FusionTracker(Matcher())) == threaded


def test_both_things_are_done_at_the_same_time() -> None:
    aside: Aside[int] = Aside()
    met = threading.Barrier(2)

    def meet() -> int:
        met.wait(WAIT_S)
        return threading.get_ident()

    aside.begin(meet)
    meet()
    assert aside.end() != threading.get_ident()
    aside.close()
    aside.begin(lambda: 7)
    assert aside.end() == 7
    aside.close()


def test_what_the_thread_has_not_begun_is_done_at_once() -> None:
    aside: Aside[int] = Aside()
    begun, may_go_on = threading.Event(), threading.Event()

    def dawdle() -> int:
        begun.set()
        may_go_on.wait(WAIT_S)
        return 0

    aside._todo.put(dawdle)
    aside.begin(threading.get_ident)
    assert begun.wait(WAIT_S)
    assert aside.end() == threading.get_ident()
    may_go_on.set()
    aside.close()


def test_what_is_done_afterwards_makes_nobody_wait() -> None:
    may_go_on, done = threading.Event(), threading.Event()

    def dawdle() -> None:
        may_go_on.wait(WAIT_S)
        done.set()

    aside: Aside[int] = Aside(dawdle)
    begun = threading.Barrier(2)
    aside.begin(lambda: begun.wait(WAIT_S))
    begun.wait(WAIT_S)
    aside.end()
    aside.begin(threading.get_ident)
    assert aside.end() == threading.get_ident(), "the owner does what the thread has no time for"
    assert not done.is_set()
    may_go_on.set()
    aside.close()
    assert done.is_set()


def test_what_fails_afterwards_is_raised_with_the_threads_next_answer() -> None:
    failing = threading.Event()
    failing.set()

    def prepare() -> None:
        if failing.is_set():
            failing.clear()
            raise ZeroDivisionError

    aside: Aside[int] = Aside(prepare)

    def answer_of_the_thread() -> int:
        begun = threading.Barrier(2)
        aside.begin(lambda: begun.wait(WAIT_S))
        begun.wait(WAIT_S)
        return aside.end()

    answer_of_the_thread()
    aside.begin(lambda: 7)
    while aside._todo.qsize():
        pass
    with pytest.raises(ZeroDivisionError):
        aside.end()
    answer_of_the_thread()
    aside.close()


def test_a_thread_whose_owner_is_forgotten_ends() -> None:
    before = threading.active_count()
    aside: Aside[int] = Aside()
    aside.begin(lambda: 7)
    assert aside.end() == 7
    assert threading.active_count() == before + 1
    thread = aside._thread
    del aside
    thread.join(WAIT_S)
    assert not thread.is_alive()


def test_an_error_in_the_thread_is_raised_to_the_asker() -> None:
    aside: Aside[float] = Aside()
    aside.begin(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        aside.end()
    with pytest.raises(RuntimeError, match="begun"):
        aside.end()
    aside.close()


def test_the_motion_tracker_looks_once_a_frame_while_the_camera_is_calm() -> None:
    matcher = Matcher()
    tracker = FusionTracker(matcher)
    calm = [Frame(_seen(2.0 * number, 0), number / 30, number) for number in range(20)]
    tracker.start(calm[0], Box(320, 180, 40, 40))
    for frame in calm[1:]:
        tracker.step(frame)
    tracker.close()
    assert matcher.updates == len(calm) - 1


def test_it_looks_once_a_frame_also_while_the_camera_pans_fast() -> None:
    """Only in the first frame it cannot know that the target moves by 0.75 of its size."""
    matcher = Matcher()
    tracker = FusionTracker(matcher)
    fast = [Frame(_seen(30.0 * number, 0), number / 30, number) for number in range(14)]
    tracker.start(fast[0], Box(560, 180, 40, 40))
    tracks = [tracker.step(frame) for frame in fast[1:]]
    tracker.close()
    assert tracks[-1].box.distance(Box(560 - 30 * 13, 180, 40, 40)) < 3
    assert matcher.updates == len(fast)


def test_a_look_that_was_in_vain_is_not_repeated() -> None:
    """A camera that shakes to and fro: the target is never where its last places point to."""
    matcher = Matcher()
    tracker = FusionTracker(matcher)
    shaken = [
        Frame(_seen(200.0 + (number % 2) * 60, 0), number / 30, number) for number in range(12)
    ]
    tracker.start(shaken[0], Box(360, 180, 40, 40))
    tracks = [tracker.step(frame) for frame in shaken[1:]]
    tracker.close()
    assert tracks[-1].box.distance(Box(300, 180, 40, 40)) < 3
    assert matcher.updates <= len(shaken) + 1


def test_a_step_without_camera_motion_starts_no_thread() -> None:
    before = threading.active_count()
    tracker = FusionTracker(Matcher(), settings=FusionSettings(camera_motion=False))
    tracker.start(_scene(0), Box(120, 170, 40, 40))
    tracker.step(_scene(1))
    assert threading.active_count() == before


MOTIONS: dict[str, Callable[[int], tuple[float, ...]]] = {
    "standing": lambda _: (0.0, 0.0),
    "panning": lambda n: (12.0 * n, -3.0 * n),
    "swinging": lambda n: (60 * np.sin(n / 3), 30 * np.cos(n / 2)),
    "turning": lambda n: (2.0 * n, 0.0, 0.02 * n),
    "approaching": lambda n: (0.0, 0.0, 0.0, 1.01**n),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_camera_motion_carries_the_ground_along(name: str) -> None:
    camera = CameraMotion()
    for number in range(25):
        before, after = (_ground_to_image(*MOTIONS[name](n)) for n in (number - 1, number))
        warp = camera.update(_seen(*MOTIONS[name](number)))
        for x, y in ((100, 100), (500, 100), (300, 300)):
            truth = after @ np.linalg.inv(before) @ (x, y, 1)
            if number:
                assert warp.point(x, y) == pytest.approx(tuple(truth[:2]), abs=1.0)


@pytest.mark.parametrize("name", MOTIONS)
def test_corners_sought_beforehand_change_no_answer(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched: list[str] = []
    search = cv2.goodFeaturesToTrack

    def noted(*given: Any) -> Any:
        searched.append(when)
        return search(*given)

    monkeypatch.setattr(cv2, "goodFeaturesToTrack", noted)
    ahead, plain = CameraMotion(), CameraMotion()
    for number in range(25):
        image = _seen(*MOTIONS[name](number))
        when = "plain"
        warp = plain.update(image)
        when = "waiting"
        assert ahead.update(image) == warp
        when = "meanwhile"
        ahead.seek()
    assert searched.count("plain") >= 4
    assert "waiting" not in searched


def _ground_to_image(
    right: float, down: float, turned: float = 0.0, zoom: float = 1.0
) -> np.ndarray:
    cosine, sine = np.cos(turned) / zoom, np.sin(turned) / zoom
    rows = [[cosine, -sine, 480 + right], [sine, cosine, 270 + down], [0, 0, 1]]
    return np.linalg.inv(np.array(rows))


def test_camera_motion_of_the_same_image_is_measured_once() -> None:
    camera = CameraMotion()
    camera.update(_seen(0, 0))
    image = _seen(30, 0)
    assert camera.update(image) is camera.update(image)


def test_camera_motion_begins_anew_after_a_reset_or_another_size() -> None:
    camera = CameraMotion()
    camera.update(_seen(0, 0))
    camera.reset()
    assert camera.update(_seen(30, 0)) == Warp()
    assert camera.update(_seen(60, 0)).right == pytest.approx(-30, abs=1)
    assert camera.update(_seen(90, 0)[::2]) == Warp()


def test_camera_motion_says_none_where_there_is_nothing_to_see() -> None:
    camera = CameraMotion()
    flat = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for image in (flat, flat.copy(), _seen(0, 0), flat.copy()):
        assert camera.update(image).point(300, 200) == pytest.approx((300, 200), abs=1e-2)


def test_a_jerk_is_noticed_in_an_image_whose_motion_was_foreseen() -> None:
    """The tracker no longer sees the target where it was: then the motion is measured at once."""
    places = [2.0 * number for number in range(20)]
    for calm in range(14, 20):
        tracker = FusionTracker(Matcher())
        for number, place in enumerate([*places[:calm], 160.0]):
            left = 400 - round(place)
            image = _seen(place, 0)
            image[150:190, left : left + 40] = _textured(7, 40, 40)
            frame, box = Frame(image, number / 30, number), Box(left + 20, 170, 40, 40)
            track = tracker.start(frame, box) if number == 0 else tracker.step(frame)
        tracker.close()
        assert track.box.iou(box) > 0.9, f"after {calm} calm images"
