"""What operators ask for from outside: refused at once, or carried out by the stages."""

import math
import threading
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower.flight.control.guidance import Guidance
from follower.flight.log import FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.target.request import (
    BoxSelection,
    PointSelection,
    RequestRefusedError,
    TargetFinder,
)
from follower.flight.threads import VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.settings.live import SettingChange, changed, live_keys, value_at
from follower.settings.settings import Settings, load_settings
from follower_control.common.strict_config import SettingsError
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_vision.clock import SimulatedClock
from follower_vision.detection import Detection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.selection import box_around
from follower_vision.trackers.track import Track, TrackState

WIDTH, HEIGHT = 160, 120
BY = "somebody"


class StillTracker:
    """Says that the target is where it was chosen."""

    def __init__(self) -> None:
        self.box: Box | None = None

    def start(self, frame: Frame, box: Box) -> Track:
        self.box = box
        return self.step(frame)

    def step(self, frame: Frame) -> Track:
        assert self.box is not None
        return Track(self.box, TrackState.TRACKING, 1.0, "still", frame.captured_s, frame.sequence)


class SeesOne:
    """A detector that sees one object, looked at closely or not."""

    class_names = ("car",)

    def __init__(self, box: Box) -> None:
        self.box = box

    def detect(self, _image: Image, _region: Box | None = None) -> list[Detection]:
        return [Detection(self.box, 0, "car", 0.9)]


def frame(number: int = 0) -> Frame:
    rng = np.random.default_rng(3)
    image = (90 + rng.normal(0, 4, (HEIGHT, WIDTH, 3))).astype(np.uint8)
    image[40:60, 70:100] = (20, 90, 230)
    return Frame(image, 0.1 * number, number)


def rig(detector: SeesOne | None = None) -> tuple[OperatorRequests, VisionLoop]:
    requests = OperatorRequests(Settings())
    stage = VisionStage(StillTracker(), requests, TargetFinder(detector))
    return requests, VisionLoop(stage, SimulatedClock(), FlightLog())


def test_a_rectangle_is_followed_from_the_next_frame_on() -> None:
    requests, vision = rig()
    request = requests.select_rectangle(0.75, 0.5, 0.25, 0.25, BY)
    assert request.outcome is None
    record = vision.step(frame())
    assert record.requests == 1
    assert record.track.box.xywh == pytest.approx((40, 30, 80, 30))
    assert request.outcome.accepted
    assert vision.step(frame(1)).requests == 1


def test_a_wish_that_waited_while_no_frames_came_is_refused_but_for_none() -> None:
    requests, vision = rig()
    vision.step(frame())
    request = requests.select_rectangle(*SHOWN, BY)
    record = vision.step(frame(30))
    assert (record.track, record.requests) == (None, 0)
    assert "choose again" in request.outcome.text
    requests.select_rectangle(*SHOWN, BY)
    assert vision.step(frame(31)).track is not None
    none = requests.stop_tracking(BY)
    assert vision.step(frame(60)).track is None
    assert none.outcome.accepted


def test_an_object_is_not_looked_for_any_more_after_no_frames_came() -> None:
    sees = SeesOne(Box(80, 48, 30, 22))
    sees.box = Box(10, 10, 8, 8)
    requests, vision = rig(sees)
    request = requests.select_object(*SHOWN, BY)
    vision.step(frame())
    sees.box = Box(80, 48, 30, 22)
    assert vision.step(frame(40)).track is None
    assert not request.outcome.accepted


def test_a_point_snaps_to_the_detection_there() -> None:
    box = Box(80, 50, 40, 24)
    requests, vision = rig(SeesOne(box))
    requests.select_point(0.55, 0.4, BY)
    track = vision.step(frame()).track
    assert track.box == box


SHOWN = 0.4, 0.3, 0.6, 0.5  # 32 x 24 px around (80, 48)


def test_an_object_that_was_shown_is_followed_where_it_is_now() -> None:
    moved = Box(96, 44, 30, 20)
    requests, vision = rig(SeesOne(moved))
    request = requests.select_object(*SHOWN, BY)
    track = vision.step(frame()).track
    assert track.box == moved
    assert request.outcome.text == "the car there"


FAR, LARGE, SMALL = Box(120, 48, 32, 24), Box(80, 48, 100, 80), Box(80, 48, 8, 6)


@pytest.mark.parametrize("box", [FAR, LARGE, SMALL])
def test_an_object_that_is_gone_is_no_target(box: Box) -> None:
    """Too far from where it was shown, or of another size, for most of a second."""
    requests, vision = rig(SeesOne(box))
    request = requests.select_object(*SHOWN, BY)
    for number in range(7):
        assert vision.step(frame(number)).track is None
        assert request.outcome is None
    vision.step(frame(7))
    assert not request.outcome.accepted
    assert "tap it again" in request.outcome.text
    assert vision.step(frame(8)).track is None


def test_an_object_that_is_not_seen_in_each_frame_is_followed_once_it_is() -> None:
    detector = SeesOne(FAR)
    requests, vision = rig(detector)
    request = requests.select_object(*SHOWN, BY)
    vision.step(frame(0))
    detector.box = Box(84, 50, 30, 24)
    track = vision.step(frame(1)).track
    assert track.box == detector.box
    assert request.outcome.accepted


def test_a_newer_wish_ends_the_search_for_an_object() -> None:
    requests, vision = rig(SeesOne(FAR))
    sought = requests.select_object(*SHOWN, BY)
    vision.step(frame(0))
    requests.select_rectangle(0.1, 0.1, 0.4, 0.4, BY)
    track = vision.step(frame(1)).track
    assert track is not None
    assert not sought.outcome.accepted
    assert vision.step(frame(2)).requests == 1


@pytest.mark.parametrize("taken", [False, True])
def test_a_selection_from_before_a_release_is_refused_but_for_none(
    taken: bool,
) -> None:
    detector = SeesOne(FAR)
    requests, vision = rig(detector)
    request = requests.select_object(*SHOWN, BY)
    if taken:
        vision.step(frame(0))
    requests.on_release()
    detector.box = Box(84, 50, 30, 24)
    record = vision.step(frame(1))
    assert (record.track, record.requests) == (None, 0)
    assert "released meanwhile" in request.outcome.text
    requests.select_object(*SHOWN, BY)
    assert vision.step(frame(2)).track is not None
    none = requests.stop_tracking(BY)
    requests.on_release()
    assert vision.step(frame(3)).track is None
    assert none.outcome.accepted


def test_an_object_without_a_detector_is_what_its_rectangle_shows() -> None:
    requests, vision = rig()
    requests.select_object(*SHOWN, BY)
    track = vision.step(frame()).track
    assert track.box.xywh == pytest.approx((64, 36, 32, 24))


def test_a_point_without_a_detection_takes_what_stands_out() -> None:
    requests, vision = rig(SeesOne(Box(20, 20, 10, 10)))
    requests.select_point(85 / WIDTH, 50 / HEIGHT, BY)
    track = vision.step(frame()).track
    assert track.box.iou(Box(85, 50, 30, 20)) > 0.7


def test_a_point_on_the_ground_is_refused_and_changes_nothing() -> None:
    requests, vision = rig()
    requests.select_rectangle(0.4, 0.3, 0.6, 0.5, BY)
    before = vision.step(frame()).track
    request = requests.select_point(0.1, 0.9, BY)
    after = vision.step(frame(1))
    assert not request.outcome.accepted
    assert "rectangle" in request.outcome.text
    assert after.requests == 1
    assert after.track.box == before.box


def test_no_target_any_more() -> None:
    requests, vision = rig()
    requests.select_rectangle(0.4, 0.3, 0.6, 0.5, BY)
    assert vision.step(frame()).track is not None
    requests.stop_tracking(BY)
    record = vision.step(frame(1))
    assert record.track is None
    assert record.requests == 2
    assert vision.step(frame(2)).track is None


def test_the_newest_wish_counts_and_the_other_one_learns_it() -> None:
    requests, vision = rig()
    first = requests.select_rectangle(0.1, 0.1, 0.2, 0.2, BY)
    second = requests.select_rectangle(0.4, 0.3, 0.6, 0.5, BY)
    assert not first.outcome.accepted
    vision.step(frame())
    assert second.outcome.accepted


def test_somebody_else_may_wait_for_the_outcome() -> None:
    requests, vision = rig()
    request = requests.select_rectangle(0.4, 0.3, 0.6, 0.5, BY)
    assert request.wait(0.0) is None
    waiter = threading.Thread(target=lambda: vision.step(frame()))
    waiter.start()
    outcome = request.wait(5.0)
    waiter.join()
    assert outcome.box is not None


any_number = st.floats(allow_nan=True, allow_infinity=True)


@given(any_number, any_number, any_number, any_number)
def test_any_rectangle_is_refused_or_lies_in_the_image(
    left: float, top: float, right: float, bottom: float
) -> None:
    try:
        box = BoxSelection(left, top, right, bottom).on(WIDTH, HEIGHT)
    except RequestRefusedError:
        return
    assert box.left >= -1e-9
    assert box.top >= -1e-9
    assert box.right <= WIDTH + 1e-9
    assert box.bottom <= HEIGHT + 1e-9
    assert min(box.width, box.height) >= 4.0


@given(any_number, any_number)
def test_any_point_is_refused_or_can_be_looked_at(x: float, y: float) -> None:
    try:
        selection = PointSelection(x, y)
    except RequestRefusedError:
        return
    outcome = TargetFinder().find(selection, frame())
    assert outcome.accepted == (outcome.box is not None)


def test_a_box_around_a_point_takes_in_all_parts_of_the_thing() -> None:
    image = frame().image.copy()
    image[40:60, 70:100] = image[10:30, 10:40]
    image[50:62, 70:80], image[62:76, 70:80] = (40, 30, 200), (120, 60, 30)
    person = Box(75, 63, 10, 26)
    for y in (54, 58, 66, 72):
        box = box_around(image, 75, y)
        assert box.iou(person) > 0.7


@pytest.mark.parametrize(("x", "y"), [(0, 0), (159.9, 0), (0, 119.9), (160, 120), (85, 50)])
def test_a_box_around_a_point_holds_it(x: float, y: float) -> None:
    box = box_around(frame().image, x, y)
    if box is not None:
        assert box.left <= x <= box.right
        assert box.top <= y <= box.bottom


def test_orders_and_a_stop_reach_control_once() -> None:
    requests = OperatorRequests(Settings())
    assert requests.take().orders == ()
    requests.give_consent("command", BY)
    requests.withdraw_consent(BY)
    requests.stop(BY)
    taken = requests.take()
    assert list(taken.orders) == [ConsentRequest.GIVE, ConsentRequest.WITHDRAW]
    assert taken.stop
    assert not requests.take().stop


@pytest.mark.parametrize("kind", ["rc", "terminal", "command"])
def test_consent_is_given_by_the_way_that_is_set_alone(kind: str) -> None:
    requests = OperatorRequests(load_settings(base={"consent": {"kind": kind}}))
    with pytest.raises(RequestRefusedError, match=kind):
        requests.give_consent("cockpit", BY)
    requests.withdraw_consent(BY)


def test_settings_change_together_or_not_at_all() -> None:
    requests = OperatorRequests(Settings())
    with pytest.raises(RequestRefusedError, match="kp"):
        requests.change_all({"servo.distance_m": 20.0, "servo.azimuth.kp": -1.0}, BY)
    assert requests.take().settings is None
    requests.change_all({"servo.distance_m": 20.0, "servo.azimuth.kp": 1.0}, BY)
    taken = requests.take()
    assert taken.settings.servo.distance_m == 20.0
    assert changed(Settings(), taken.changes) == taken.settings == requests.settings


@pytest.mark.parametrize("value", [math.nan, math.inf, None, "fast", -1.0, 0.0, 1e9])
def test_nonsense_is_refused(value: object) -> None:
    requests = OperatorRequests(Settings())
    with pytest.raises(RequestRefusedError, match="distance_m"):
        requests.change("servo.distance_m", value, BY)
    assert requests.settings == Settings()


@pytest.mark.parametrize("key", ["link.vehicle_id", "envelope.max_jerk_m_s3", "consent.kind", ""])
def test_what_is_not_for_flight_is_refused(key: str) -> None:
    with pytest.raises(RequestRefusedError, match="in flight"):
        OperatorRequests(Settings()).change(key, 1.0, BY)


@pytest.mark.parametrize(
    ("key", "tighter", "looser"),
    [
        ("envelope.max_speed_m_s", 4.0, 10.1),
        ("envelope.min_height_m", 5.0, 2.9),
        ("envelope.ceiling_m", 40.0, None),
        ("envelope.fence_radius_m", 50.0, 201.0),
        ("envelope.min_distance_m", 6.0, 3.0),
        ("supervisor.coast_s", 0.5, 3000.0),
        ("supervisor.search_s", 5.0, 10.5),
        ("supervisor.hold_s", 1.0, 3.5),
    ],
)
def test_a_limit_is_tightened_and_loosened_to_what_it_was(
    key: str, tighter: float, looser: float | None
) -> None:
    requests, before = OperatorRequests(Settings()), value_at(Settings(), key)
    requests.change(key, tighter, BY)
    assert value_at(requests.settings, key) == tighter
    requests.change(key, before, BY)
    with pytest.raises(RequestRefusedError, match="tightened"):
        requests.change(key, looser, BY)
    assert value_at(requests.settings, key) == before


def test_every_live_key_is_there_and_may_be_set_to_what_it_is() -> None:
    settings = load_settings(base={"servo": {"target_size_m": 1.5}})
    keys = [one.key for one in live_keys()]
    assert len(set(keys)) == len(keys) > 50
    same = [SettingChange.of(key, value_at(settings, key)) for key in keys]
    assert changed(settings, same, settings) == settings


@given(st.sampled_from([one.key for one in live_keys()]), st.floats(allow_nan=True))
def test_any_value_is_refused_or_replays_to_the_same_settings(key: str, value: float) -> None:
    requests = OperatorRequests(Settings())
    try:
        settings = requests.change(key, value, BY)
    except RequestRefusedError:
        return
    assert changed(Settings(), requests.take().changes) == settings


# As an unbounded 32-bit MAVLink parameter may bring them.
EXTREMES = (3.4e38, -3.4e38, 1e6, 0.5, 0.0, 1e-38, -1e-3, -0.5)


@pytest.mark.parametrize("key", [one.key for one in live_keys()])
@pytest.mark.parametrize(
    "state", [SupervisorState.FOLLOWING, SupervisorState.COASTING, SupervisorState.SEARCHING]
)
def test_whatever_is_accepted_can_be_flown(key: str, state: SupervisorState) -> None:
    """What is refused too late, where control takes it, would end the flight."""
    for value in EXTREMES:
        requests = OperatorRequests(Settings())
        try:
            accepted = requests.change(key, value, BY)
        except RequestRefusedError:
            continue
        steering, vehicle = Guidance(Settings()), flying(0.0)
        steering.begin(vehicle, 0.0)
        steering.step(SupervisorState.FOLLOWING, 0.0, seen(0.0), vehicle, 0.0)
        steering.begin_search(vehicle)
        steering.change(accepted)
        for now_s in (0.02, 0.04, 0.06):
            limited = steering.step(state, now_s, seen(now_s), flying(now_s), 0.1)
            assert all(map(math.isfinite, astuple(limited.allowed)))


def flying(time_s: float) -> VehicleState:
    return VehicleState(
        attitude=Attitude(0, 0, 0.1, 0, 0, 0, time_s),
        position=LocalPosition(0, 0, -5, 1, 1, 0, time_s),
    )


def seen(time_s: float) -> TargetEstimate:
    return TargetEstimate(
        time_s, 0.2, -0.3, -2.3, 0.1, -0.1, 0.01, np.eye(6), time_s, BearingFrame.WORLD
    )


def test_a_change_of_another_program_version_is_refused_in_words() -> None:
    with pytest.raises(SettingsError, match=r"servo\.gone"):
        changed(Settings(), [SettingChange("servo.gone", "1.0")])


@pytest.mark.parametrize(
    ("began", "asked", "taken"),
    [
        (1.7, 1.5, True),
        (1.7, 17.0, False),
        (1.7, None, False),
        (None, 1.5, False),
        (None, None, True),
        (1.7, 5e-324, False),
    ],
)
def test_a_target_can_be_made_to_seem_nearer_in_flight_and_not_farther_away(
    began: float | None, asked: float | None, taken: bool
) -> None:
    """Or the least distance to it, which is kept by that, would be no limit."""
    requests = OperatorRequests(load_settings(base={"servo": {"target_size_m": began}}))
    if taken:
        assert requests.change("servo.target_size_m", asked, BY).servo.target_size_m == asked
    else:
        with pytest.raises(RequestRefusedError, match="target_size_m"):
            requests.change("servo.target_size_m", asked, BY)
