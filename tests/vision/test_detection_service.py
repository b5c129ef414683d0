"""Detection at once, in the background and shared; nobody waits for the one in the background."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time

import cv2
import numpy as np
import pytest

from follower_vision.clock import SimulatedClock
from follower_vision.detection.detection import Detection
from follower_vision.detection.detection_service import (
    REST_SHARE,
    URGENT_REST_SHARE,
    DetectionRequest,
    SharedDetection,
)
from follower_vision.fusion import (
    BackgroundDetection,
    FusionSettings,
    FusionTracker,
    InlineDetection,
)
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.motion_tracker import IdentityTracker

WAIT_S = 60.0
BOX = Box(120, 170, 40, 40)
IMAGE: Image = np.zeros((480, 640, 3), np.uint8)
GROUND = np.random.default_rng(3).integers(0, 120, (480, 640, 3), np.uint8)


class SquareDetector:
    """Finds white squares of any size on a darker ground, in the region asked for."""

    class_names = ("square",)

    def __init__(self) -> None:
        self.regions: list[Box | None] = []
        self.may_answer = threading.Event()
        self.may_answer.set()

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        self.regions.append(region)
        assert self.may_answer.wait(WAIT_S)
        found = []
        for row in _runs((image[..., 0] == 255).any(axis=1)):
            strip = (image[row[0] : row[1], :, 0] == 255).any(axis=0)
            for left, right in _runs(strip):
                box = Box.from_xywh(left, row[0], right - left, row[1] - row[0])
                if region is None or region.intersection(box) > 0:
                    found.append(Detection(box, 0, "square", 0.9))
        return found


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


BUSY_S = 0.05


class BusyDetector:
    """Keeps a processor busy for a while."""

    class_names = ("thing",)

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        until_s = time.thread_time() + BUSY_S
        while time.thread_time() < until_s:
            pass
        return []


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


def _scene(number: int, *places: tuple[float, float]) -> Frame:
    image = GROUND.copy()
    for x, y in places:
        left, top = round(x - 15), round(y - 15)
        image[top : top + 30, left : left + 30] = 255
    image[0, 0, 0] = number % 100
    return Frame(image, number / 30, number)


def _request(
    owner: object, index: int, region: Box | None, image: Image = IMAGE
) -> DetectionRequest:
    return DetectionRequest(owner, index, image, region)


def test_background_detection_never_makes_the_asker_wait() -> None:
    detector = SquareDetector()
    service = BackgroundDetection(detector)
    detector.may_answer.clear()
    service.submit(_request(1, 5, None))
    assert not service.ready()
    assert service.take(1) == []
    detector.may_answer.set()
    assert service.wait_idle(WAIT_S)
    assert [answer.request.index for answer in service.take(1)] == [5]
    assert service.take(1) == []
    service.close()


@pytest.mark.parametrize(("urgent", "share"), [(False, REST_SHARE), (True, URGENT_REST_SHARE)])
def test_background_detection_rests_after_its_work_the_longer_the_less_it_is_needed(
    urgent: bool, share: float
) -> None:
    """So it takes a fifth of a core at most as a rule, and two thirds while a target is lost."""
    clock, rest_s = SimulatedClock(), share * BUSY_S
    service = BackgroundDetection(BusyDetector(), clock)
    assert service.ready(urgent=urgent)
    service.submit(_request(1, 5, None))
    assert service.wait_idle(WAIT_S)
    clock.sleep_until(0.7 * rest_s)
    assert not service.ready(urgent=urgent)
    clock.sleep_until(1.5 * rest_s)
    assert service.ready(urgent=urgent)
    service.close()


def test_at_a_cameras_rate_the_rest_holds_no_detection_back() -> None:
    """A detection of 16 ms, 30 frames a second, and the pauses that Fusion makes anyway."""
    settings, took_s = FusionSettings(), 0.016
    assert took_s * (1 + REST_SHARE) < settings.validate_every / 30
    assert took_s * (1 + URGENT_REST_SHARE) < settings.doubt_every / 30


def test_background_detection_that_only_waits_need_not_rest() -> None:
    """A thread that a busy machine keeps waiting has not taken anything from anybody."""
    detector, clock = SquareDetector(), SimulatedClock()
    service = BackgroundDetection(detector, clock)
    detector.may_answer.clear()
    service.submit(_request(1, 5, None))
    clock.sleep_until(100.0)
    detector.may_answer.set()
    assert service.wait_idle(WAIT_S)
    clock.sleep_until(200.0)  # of the wait it would rest for 400 s
    assert service.ready()
    service.close()


@pytest.mark.parametrize("kind", [RuntimeError, cv2.error, IndexError, MemoryError])
def test_background_detection_reports_an_error_of_the_detector(kind: type[Exception]) -> None:
    class Broken(SquareDetector):
        def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
            raise kind(f"no network for {image.shape} in {region}")

    service = BackgroundDetection(Broken())
    service.submit(_request(1, 0, None))
    assert service.wait_idle(WAIT_S)
    with pytest.raises(RuntimeError, match="background"):
        service.take(1)
    service.close()


def test_what_nobody_will_come_for_is_dropped() -> None:
    detector = SquareDetector()
    background = BackgroundDetection(detector)
    shared = SharedDetection(InlineDetection(detector))
    for owner in ("mine", "other"):
        detector.may_answer.clear()
        background.submit(_request(owner, 1, None))
        background.forget("mine")  # while it is worked on
        detector.may_answer.set()
        assert background.wait_idle(WAIT_S)
        shared.submit(_request(owner, 1, None))
    shared.flush()
    shared.forget("mine")
    for service in (background, shared):
        assert service.take("mine") == []
        assert [one.request.owner for one in service.take("other")] == ["other"]
    background.submit(_request("mine", 2, None))
    assert background.wait_idle(WAIT_S)
    background.forget("mine")  # after it
    assert background.take("mine") == []
    background.close()


def test_close_regions_share_one_pass_and_far_ones_take_turns() -> None:
    detector = SquareDetector()
    shared = SharedDetection(InlineDetection(detector))
    owners = [object(), object(), object()]
    near, far = Box(140, 100, 128, 128), Box(500, 400, 128, 128)
    shared.submit(_request(owners[0], 1, Box(100, 100, 128, 128)))
    shared.submit(_request(owners[1], 1, near))
    shared.submit(_request(owners[2], 1, far))
    shared.flush()
    assert [len(shared.take(owner)) for owner in owners] == [1, 1, 0]
    shared.flush()
    assert [len(shared.take(owner)) for owner in owners] == [0, 0, 1]
    assert shared.passes == len(detector.regions) == 2
    assert detector.regions[1] == far


def test_shared_answer_holds_what_lies_in_the_own_region() -> None:
    shared = SharedDetection(InlineDetection(SquareDetector()))
    image = _scene(0, (100.0, 100.0), (190.0, 100.0)).image
    shared.submit(_request("a", 1, Box(100, 100, 128, 128), image))
    shared.submit(_request("b", 1, Box(190, 100, 128, 128), image))
    shared.flush()
    assert [one.box.cx for one in shared.take("a")[0].detections] == [100]
    assert [one.box.cx for one in shared.take("b")[0].detections] == [190]


def test_every_frame_is_answered_while_the_detector_never_answers() -> None:
    """If a step waited for the detection, the detector's own assertion would stop this test."""
    detector = StuckDetector()
    tracker = FusionTracker(IdentityTracker(), detector, mode=BackgroundDetection)
    tracker.start(_scene(0), BOX)
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
    tracker = FusionTracker(IdentityTracker(), detector, mode=lambda _: service)
    tracker.start(_scene(0), BOX)
    assert detector.begun.acquire(timeout=WAIT_S)
    assert detector.niceness > os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    detector.may_answer.set()
    tracker.close()


_LEAVES_AT_ONCE = """
import time
import numpy as np
from follower_vision.fusion import BackgroundDetection
from follower_vision.detection.detection_service import DetectionRequest

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


@pytest.mark.slow
def test_a_program_that_ends_lets_the_detection_finish() -> None:
    """A thread that is cut off inside a network ends the program with an abort."""
    left = subprocess.run(
        [sys.executable, "-c", _LEAVES_AT_ONCE], capture_output=True, text=True, timeout=WAIT_S
    )
    assert (left.returncode, left.stdout) == (0, "finished\n")
