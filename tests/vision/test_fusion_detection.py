"""Detection at once, in the background and shared; several targets."""

from __future__ import annotations

import itertools
import threading
import time

import cv2
import numpy as np
import pytest

from follower_vision.box import Box
from follower_vision.clock import SimulatedClock
from follower_vision.detection.detection import Detection
from follower_vision.frame import Frame, Image
from follower_vision.fusion import (
    BackgroundDetection,
    FusionSettings,
    FusionTracker,
    InlineDetection,
    MultiFusion,
)
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.camera_motion import CameraMotion
from follower_vision.fusion.detection_service import REST_SHARES, DetectionRequest, Need
from follower_vision.fusion.following import Following
from follower_vision.fusion.history import History
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.neighbours import Neighbours, assign_target, claimed_boxes
from follower_vision.fusion.scanning import around
from follower_vision.fusion.shared_detection import SharedDetection
from follower_vision.fusion.validation import Sight, Validation
from follower_vision.fusion.warp import Warp
from follower_vision.motion import MotionEstimate
from follower_vision.track import TrackState

IMAGE: Image = np.zeros((480, 640, 3), np.uint8)


class SquareDetector:
    """Finds white squares of any size on a darker ground, in the region asked for."""

    class_names = ("square",)

    def __init__(self) -> None:
        self.regions: list[Box | None] = []
        self.may_answer = threading.Event()
        self.may_answer.set()

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        self.regions.append(region)
        assert self.may_answer.wait(10)
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


class LaggingTracker:
    """Goes half the way to the middle of the white pixels about its box."""

    name = "lagging"

    def start(self, image: Image, box: Box) -> None:  # noqa: ARG002  part of the interface
        self._box = box

    def move_to(self, box: Box) -> None:
        self._box = box

    def update(self, image: Image) -> MotionEstimate:
        left, top = max(0, round(self._box.left - 15)), max(0, round(self._box.top - 15))
        rows, columns = np.nonzero(image[top : top + 60, left : left + 60, 0] == 255)
        if rows.size == 0:
            return MotionEstimate(self._box, 0.1)
        right, down = columns.mean() + left - self._box.cx, rows.mean() + top - self._box.cy
        self._box = self._box.moved_to(self._box.cx + right / 2, self._box.cy + down / 2)
        return MotionEstimate(self._box, 0.9)


GROUND = np.random.default_rng(3).integers(0, 120, (480, 640, 3), np.uint8)


def _scene(number: int, *places: tuple[float, float]) -> Frame:
    image = GROUND.copy()
    for x, y in places:
        left, top = round(x - 15), round(y - 15)
        image[top : top + 30, left : left + 30] = 255
    image[0, 0, 0] = number % 100
    return Frame(image, number / 30, number)


def _request(owner: object, index: int, region: Box | None, image: Image = IMAGE) -> object:
    return DetectionRequest(owner, index, image, region)


def test_background_detection_never_makes_the_asker_wait() -> None:
    detector = SquareDetector()
    service = BackgroundDetection(detector)
    detector.may_answer.clear()
    service.submit(_request(1, 5, None))
    assert not service.ready()
    assert service.take(1) == []
    detector.may_answer.set()
    assert service.wait_idle(10)
    assert [answer.request.index for answer in service.take(1)] == [5]
    assert service.take(1) == []
    service.close()


def test_background_detection_rests_after_its_work_the_longer_the_less_it_is_needed() -> None:
    """So it takes a fifth of a core at most as a rule, and two thirds while a target is lost."""
    clock = SimulatedClock()
    service = BackgroundDetection(BusyDetector(), clock)
    assert service.ready()
    service.submit(_request(1, 5, None))
    assert service.wait_idle(10)
    assert not any(service.ready(need) for need in Need)
    ready: list[set[Need]] = []
    for rest in (1.0, 3.0, 6.0, 12.0):
        clock.sleep_until(rest * BUSY_S)
        ready.append({need for need in Need if service.ready(need)})
    urgent = {Need.URGENT}
    doubtful = urgent | {Need.DOUBTFUL}
    assert ready == [urgent, doubtful, doubtful | {Need.USUAL}, set(Need)]
    service.close()


@pytest.mark.parametrize("need", Need)
def test_at_a_cameras_rate_the_rest_holds_no_detection_back(need: Need) -> None:
    """A detection of 16 ms, 30 frames a second, and the pauses that Fusion makes anyway."""
    settings, took_s = FusionSettings(), 0.016
    pauses = {Need.STEADY: settings.validate_steady_every, Need.USUAL: settings.validate_every}
    pause_s = pauses.get(need, settings.search_every) / 30
    assert took_s * (1 + REST_SHARES[need]) < pause_s


def test_background_detection_that_only_waits_need_not_rest() -> None:
    """A thread that a busy machine keeps waiting has not taken anything from anybody."""
    detector, clock = SquareDetector(), SimulatedClock()
    service = BackgroundDetection(detector, clock)
    detector.may_answer.clear()
    service.submit(_request(1, 5, None))
    clock.sleep_until(100.0)
    detector.may_answer.set()
    assert service.wait_idle(10)
    clock.sleep_until(100.1)
    assert service.ready()
    service.close()


@pytest.mark.parametrize("kind", [RuntimeError, cv2.error, IndexError, MemoryError])
def test_background_detection_reports_an_error_of_the_detector(kind: type[Exception]) -> None:
    class Broken(SquareDetector):
        def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
            raise kind(f"no network for {image.shape} in {region}")

    service = BackgroundDetection(Broken())
    service.submit(_request(1, 0, None))
    assert service.wait_idle(10)
    with pytest.raises(RuntimeError, match="background"):
        service.take(1)
    service.close()


def test_late_answer_corrects_the_present_box() -> None:
    detector = SquareDetector()
    services: list[BackgroundDetection] = []

    def mode(one: SquareDetector) -> BackgroundDetection:
        services.append(BackgroundDetection(one))
        return services[-1]

    tracker = FusionTracker(LaggingTracker(), detector, mode=mode)
    tracker.start(_scene(0, (100.0, 200.0)), Box(100, 200, 30, 30))
    for number in range(1, 90):
        x = 100.0 + 2 * number
        if number % 7 == 3:
            detector.may_answer.clear()
        if number % 7 == 6:
            detector.may_answer.set()
            services[0].wait_idle(10)
        track = tracker.step(_scene(number, (x, 200.0)))
    detector.may_answer.set()
    tracker.close()
    assert track.state is TrackState.TRACKING
    assert abs(track.box.cx - x) < 8


def test_answer_for_an_earlier_target_is_ignored() -> None:
    detector = SquareDetector()
    services: list[BackgroundDetection] = []

    def mode(one: SquareDetector) -> BackgroundDetection:
        services.append(BackgroundDetection(one))
        return services[-1]

    tracker = FusionTracker(LaggingTracker(), detector, mode=mode)
    scene = _scene(0, (100.0, 200.0), (400.0, 200.0))
    detector.may_answer.clear()
    tracker.start(scene, Box(100, 200, 30, 30))
    tracker.start(scene, Box(400, 200, 30, 30))
    detector.may_answer.set()
    assert services[0].wait_idle(10)
    track = tracker.step(_scene(1, (100.0, 200.0), (400.0, 200.0)))
    tracker.close()
    assert track.box.cx == pytest.approx(400, abs=3)
    assert track.produced_by == "lagging"


def test_what_nobody_will_come_for_is_dropped() -> None:
    detector = SquareDetector()
    background = BackgroundDetection(detector)
    shared = SharedDetection(InlineDetection(detector))
    for owner in ("mine", "other"):
        detector.may_answer.clear()
        background.submit(_request(owner, 1, None))
        background.forget("mine")  # while it is worked on
        detector.may_answer.set()
        assert background.wait_idle(10)
        shared.submit(_request(owner, 1, None))
    shared.flush()
    shared.forget("mine")
    for service in (background, shared):
        assert service.take("mine") == []
        assert [one.request.owner for one in service.take("other")] == ["other"]
    background.submit(_request("mine", 2, None))
    assert background.wait_idle(10)
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


def test_four_targets_are_followed_with_one_pass_a_frame_at_most() -> None:
    places = [(100.0, 100.0), (180.0, 180.0), (400.0, 100.0), (500.0, 400.0)]
    multi = MultiFusion(LaggingTracker, SquareDetector())
    multi.start(_scene(0, *places), [Box(x, y, 30, 30) for x, y in places])
    for number in range(1, 60):
        moved = [(x + number * 0.5, y) for x, y in places]
        tracks = multi.step(_scene(number, *moved))
    assert all(track.state is TrackState.TRACKING for track in tracks)
    assert max(abs(t.box.cx - x) for t, (x, _) in zip(tracks, moved, strict=True)) < 8
    assert multi.passes <= 60
    multi.close()


def test_a_target_that_vanishes_is_not_mistaken_for_another_target() -> None:
    multi = MultiFusion(LaggingTracker, SquareDetector())
    left = [(170.0, 100.0 + 2 * number) for number in range(80)]
    right = [(300.0, 100.0 + 2 * number) for number in range(80)]
    multi.start(_scene(0, left[0], right[0]), [Box(*left[0], 30, 30), Box(*right[0], 30, 30)])
    for number in range(1, 80):
        places = [right[number]] if number >= 30 else [left[number], right[number]]
        frame = _scene(number, *places)
        frame.image[..., 1] ^= np.uint8(number % 16)  # else the frame check calls it frozen
        first, second = multi.step(frame)
        assert second.state is TrackState.TRACKING
        assert abs(second.box.cx - right[number][0]) < 10
    assert first.state is not TrackState.TRACKING
    multi.close()


def test_a_detection_that_is_another_targets_is_left_to_it() -> None:
    frame, box = _scene(0, (100.0, 100.0), (200.0, 100.0)), Box(100, 100, 30, 30)
    settings = FusionSettings()
    looks = Looks(settings.reidentify)
    looks.start(frame, box)
    validation = Validation(settings, Following(LaggingTracker(), settings, looks), looks)
    belief = Belief(frame, box, "lagging")
    sight = Sight(belief.now, [Box(200, 100, 30, 30), Box(102, 100, 30, 30)], [])
    assert validation.unclaimed(belief, sight) == sight.boxes
    belief.taken = [Box(203, 101, 30, 30)]
    assert validation.unclaimed(belief, sight) == sight.boxes[1:]


def test_multi_fusion_takes_one_to_four_targets() -> None:
    multi = MultiFusion(LaggingTracker, SquareDetector())
    with pytest.raises(RuntimeError):
        multi.step(_scene(0))
    with pytest.raises(ValueError, match="1 to 4"):
        multi.start(_scene(0), [])
    with pytest.raises(ValueError, match="1 to 4"):
        multi.start(_scene(0), [Box(50, 50, 10, 10)] * 5)


def test_identity_goes_to_the_box_that_leaves_the_neighbours_theirs() -> None:
    assert assign_target([0.5, 0.6], [[0.0, 0.9]]) == 0
    assert assign_target([0.5, 0.6], []) == 1
    assert assign_target([0.4], [[0.9]]) is None
    assert assign_target([], []) is None
    assert assign_target([0.0], []) is None


def test_the_neighbours_take_a_box_each_and_leave_the_one_beside_theirs() -> None:
    boxes = [Box(100, 50, 20, 20), Box(118, 50, 20, 20), Box(300, 50, 20, 20)]
    assert claimed_boxes(boxes, [[0.9, 0.4, 0.0]]) == boxes[:1]
    assert claimed_boxes(boxes, [[0.9, 0.4, 0.0], [0.8, 0.7, 0.0]]) == boxes[:2]
    assert claimed_boxes(boxes, []) == []


def _walked(neighbours: Neighbours, history: History) -> None:
    """A look-alike goes 8 pixels a tenth of a second, 5 of them by the camera's motion."""
    for number in range(10):
        warp = Warp(right=5.0) if number else Warp()
        moment = history.add(number / 10, warp, Box(0, 0, 10, 10))
        boxes = [Box(100 + 8.0 * number, 50, 20, 20)]
        neighbours.see(boxes, boxes if number == 0 else [], history, moment)


def test_neighbours_are_expected_where_camera_and_velocity_carry_them() -> None:
    history, neighbours = History(), Neighbours()
    _walked(neighbours, history)
    later = history.add(1.0, Warp(right=5.0), Box(0, 0, 10, 10))
    (neighbour,) = neighbours.known
    assert neighbour.expected(history, later).cx == pytest.approx(180, abs=1.0)


def test_a_neighbour_keeps_its_size_when_half_of_it_is_seen_once() -> None:
    history, neighbours = History(), Neighbours()
    _walked(neighbours, history)
    half = history.add(1.0, Warp(right=5.0), Box(0, 0, 10, 10))
    neighbours.see([Box(178, 50, 13, 13)], [], history, half)
    later = history.add(1.1, Warp(right=5.0), Box(0, 0, 10, 10))
    ((claim,),) = neighbours.claims([Box(187, 50, 20, 20)], history, later)
    assert claim > 0.5


def test_a_passer_by_is_a_look_alike_while_the_target_is_waited_for() -> None:
    history, neighbours = History(), Neighbours()
    box = Box(100, 50, 20, 20)
    for number in range(3):
        moment = history.add(number / 10, Warp(), Box(0, 0, 10, 10))
        neighbours.see([box], [], history, moment, passers=[box])
    assert neighbours.claims([box], history, moment) == []
    ((claim,),) = neighbours.claims([box], history, moment, all_of_them=True)
    assert claim == pytest.approx(1.0)
    neighbours.see([box], [box], history, history.add(0.3, Warp(), Box(0, 0, 10, 10)))
    assert len(neighbours.claims([box], history, moment)) == 1


def test_warps_compose_and_undo() -> None:
    one, two = Warp(0.9, 0.1, 3.0, -2.0), Warp(1.05, -0.2, -7.0, 4.0)
    x, y = two.point(*one.point(12.0, 34.0))
    assert one.then(two).point(12.0, 34.0) == pytest.approx((x, y))
    assert one.then(two).back().point(x, y) == pytest.approx((12.0, 34.0))


def test_a_fast_swing_is_measured_where_flow_follows_nothing() -> None:
    rng = np.random.default_rng(3)
    grain = np.kron(rng.uniform(0, 255, (90, 160)), np.ones((4, 4))).astype(np.uint8)
    wide = np.repeat(grain[..., None], 3, axis=2)
    camera = CameraMotion()
    camera.update(np.ascontiguousarray(wide[:240, :320]))
    warp = camera.update(np.ascontiguousarray(wide[20:260, 90:410]))
    assert (warp.right, warp.down) == pytest.approx((-90.0, -20.0), abs=2.0)


def test_a_cut_to_another_scene_is_no_motion() -> None:
    rng = np.random.default_rng(4)
    images = rng.integers(0, 256, (2, 240, 320, 3), dtype=np.uint8)
    camera = CameraMotion()
    camera.update(images[0])
    assert camera.update(images[1]) == Warp()


def test_half_a_motion_done_twice_is_the_motion() -> None:
    motion = Warp(1.02, 0.05, -30.0, 12.0)
    half = motion.halved()
    assert half.then(half).point(12.0, 34.0) == pytest.approx(motion.point(12.0, 34.0))
    assert Warp().halved() == Warp()


def test_an_even_motion_is_measured_in_every_other_image() -> None:
    """What the tracker is told adds up to the truth, also when the camera stops."""
    rng = np.random.default_rng(5)
    grain = cv2.resize(rng.integers(0, 255, (120, 200), np.uint8), (1600, 960))
    wide = np.repeat(grain[..., None], 3, axis=2)
    camera, target, total, foreseen = CameraMotion(), Box(160, 120, 40, 40), 0.0, []
    places = [min(3 * number, 60) for number in range(30)]
    for number, place in enumerate(places):
        image = np.ascontiguousarray(wide[200:440, 100 + place : 420 + place])
        foreseen.append(camera.foreseeable(image, [target]))
        warp = camera.foresee(image) if foreseen[-1] else camera.update(image, [target])
        total += warp.right
        if number and not foreseen[-1]:
            assert total == pytest.approx(-place, abs=1.0)
    assert foreseen[:3] == [False] * 3
    assert not any(one and two for one, two in itertools.pairwise(foreseen))
    assert sum(foreseen[3:21]) >= 8


def test_a_motion_that_is_large_beside_the_target_is_measured_in_every_image() -> None:
    rng = np.random.default_rng(7)
    grain = cv2.resize(rng.integers(0, 255, (120, 200), np.uint8), (1600, 960))
    wide = np.repeat(grain[..., None], 3, axis=2)
    camera, small = CameraMotion(), Box(160, 120, 8, 8)
    for place in range(0, 40, 4):
        image = np.ascontiguousarray(wide[200:440, 100 + place : 420 + place])
        assert not camera.foreseeable(image, [small])
        camera.update(image, [small])


def test_a_motion_that_changes_is_measured_in_every_image() -> None:
    rng = np.random.default_rng(6)
    grain = cv2.resize(rng.integers(0, 255, (120, 200), np.uint8), (1600, 960))
    wide = np.repeat(grain[..., None], 3, axis=2)
    camera, target = CameraMotion(), Box(160, 120, 40, 40)
    for place in (0, 4, 16, 18, 30, 34, 46, 50, 62):
        image = np.ascontiguousarray(wide[200:440, 100 + place : 420 + place])
        assert not camera.foreseeable(image, [target])
        camera.update(image, [target])


def test_scan_goes_around_the_box_and_stays_in_the_image() -> None:
    box = Box(30, 30, 20, 20)
    places = [around(box, 2 * box.scale, turn, 200, 100) for turn in range(40)]
    assert all(0 <= place.cx <= 200 and 0 <= place.cy <= 100 for place in places)
    assert max(place.distance(box) for place in places[:3]) < 60
    assert len({(place.cx, place.cy) for place in places[:8]}) == 8
