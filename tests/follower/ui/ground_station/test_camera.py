"""The MAVLink camera, as QGroundControl and a hostile sender meet it."""

import math
from collections.abc import Callable
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.target.request import (
    BoxSelection,
    ClearSelection,
    PointSelection,
    RequestOutcome,
)
from follower.links.packet_parser import checksum, crc_extra_of
from follower.ui.ground_station.camera_messages import Endpoint
from follower.ui.ground_station.server import HEARD
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import TrackState

MakeRig = Callable[..., Any]
POINT, RECTANGLE = mavlink.MAV_CMD_CAMERA_TRACK_POINT, mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE
STOP, INTERVAL = mavlink.MAV_CMD_CAMERA_STOP_TRACKING, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE
ACCEPTED, DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
IMAGE_STATUS, GEO_STATUS = 275, 276
VIDEO = "rtsp://192.168.1.5:8554/live"


def answer(rig: Any, peer: Any, command: int, *params: float, **options: Any) -> int:
    """Send a command and return what it was acknowledged with."""
    before = len(peer.of("COMMAND_ACK"))
    peer.command(command, *params, **options)
    rig.run(0.06)
    (ack,) = peer.of("COMMAND_ACK")[before:]
    assert ack.command == command
    assert (ack.target_system, ack.target_component) == (255, 190)
    return int(ack.result)


def test_it_is_heard_once_a_second_as_a_camera_of_the_vehicle(rig: Any, qgc: Any) -> None:
    rig.run(5.0)
    beats = qgc.of("HEARTBEAT", 100)
    assert 5 <= len(beats) <= 6
    assert all(beat.get_srcSystem() == 1 for beat in beats)
    assert {(beat.type, beat.autopilot) for beat in beats} == {
        (mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID)
    }


class QGroundControl:
    """The camera's side of QGroundControl: its timing, its alternating commands, its retries."""

    OLD_AND_NEW: ClassVar = {
        "CAMERA_INFORMATION": (259, mavlink.MAV_CMD_REQUEST_CAMERA_INFORMATION),
        "CAMERA_SETTINGS": (260, mavlink.MAV_CMD_REQUEST_CAMERA_SETTINGS),
        "VIDEO_STREAM_INFORMATION": (269, mavlink.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION),
        "CAMERA_CAPTURE_STATUS": (262, mavlink.MAV_CMD_REQUEST_CAMERA_CAPTURE_STATUS),
        "STORAGE_INFORMATION": (261, mavlink.MAV_CMD_REQUEST_STORAGE_INFORMATION),
    }
    AFTER_S: ClassVar = {
        "CAMERA_SETTINGS": 0.5,
        "VIDEO_STREAM_INFORMATION": 1.0,
        "CAMERA_CAPTURE_STATUS": 1.5,
        "STORAGE_INFORMATION": 2.0,
    }
    MOST_TRIES = 10

    def __init__(self, peer: Any) -> None:
        self.peer = peer
        self.tries: dict[str, int] = {}
        self.asked_s: dict[str, float] = {}
        self.known_s: float | None = None

    def step(self, now_s: float) -> None:
        self.peer.say_hello(now_s)
        if not self.peer.of("HEARTBEAT", 100):
            return
        self._ask("CAMERA_INFORMATION", now_s, 3.0)
        information = self.peer.of("CAMERA_INFORMATION")
        if not information:
            return
        self.known_s = self.known_s or now_s
        for name, after_s in self.AFTER_S.items():
            if name.startswith("VIDEO") and not information[0].flags & 256:
                continue
            if now_s - self.known_s >= after_s:
                self._ask(name, now_s, 1.0)

    def _ask(self, name: str, now_s: float, every_s: float) -> None:
        tries = self.tries.get(name, 0)
        too_soon = now_s - self.asked_s.get(name, -math.inf) < every_s
        if self.peer.of(name) or too_soon or tries >= self.MOST_TRIES:
            return
        self.tries[name], self.asked_s[name] = tries + 1, now_s
        message_id, old = self.OLD_AND_NEW[name]
        if tries % 2 == 0:
            self.peer.command(REQUEST, message_id, 0.0)
        else:
            self.peer.command(old, 1.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_the_whole_handshake_of_qgroundcontrol(make_rig: MakeRig, loss: float, seed: int) -> None:
    rig = make_rig(video_uri=VIDEO)
    peer = rig.station_peer(loss=loss, seed=seed)
    qgc = QGroundControl(peer)
    rig.run(25.0, qgc.step)
    for name in QGroundControl.OLD_AND_NEW:
        assert peer.of(name, 100), f"{name} after {qgc.tries.get(name)} tries"
    if not loss:
        assert set(qgc.tries.values()) == {1}
    information = peer.of("CAMERA_INFORMATION")[0]
    assert information.flags == 256 | 512 | 1024 | 2048
    assert (information.resolution_h, information.resolution_v) == (640, 480)
    video = peer.of("VIDEO_STREAM_INFORMATION")[0]
    assert (video.uri, video.type, video.count) == (VIDEO, mavlink.VIDEO_STREAM_TYPE_RTSP, 1)
    assert peer.of("CAMERA_SETTINGS")[0].mode_id == mavlink.CAMERA_MODE_VIDEO
    assert {ack.result for ack in peer.of("COMMAND_ACK")} == {ACCEPTED}


def test_without_video_none_is_told_of(rig: Any, qgc: Any) -> None:
    assert answer(rig, qgc, REQUEST, 259) == ACCEPTED
    assert not qgc.of("CAMERA_INFORMATION")[0].flags & 256
    assert answer(rig, qgc, REQUEST, 269) == DENIED
    assert answer(rig, qgc, mavlink.MAV_CMD_VIDEO_START_STREAMING, 1) == DENIED


@pytest.mark.parametrize(
    ("uri", "told"), [("rtp:5600", "5600"), ("udp://0.0.0.0:5600", "udp://0.0.0.0:5600")]
)
def test_rtp_by_udp_is_told_as_a_port_or_an_address(make_rig: MakeRig, uri: str, told: str) -> None:
    rig = make_rig(video_uri=uri)
    qgc = rig.station_peer()
    answer(rig, qgc, REQUEST, 269)
    video = qgc.of("VIDEO_STREAM_INFORMATION")[0]
    assert (video.uri, video.type) == (told, mavlink.VIDEO_STREAM_TYPE_RTPUDP)


@pytest.mark.parametrize(
    ("command", "params", "result"),
    [
        (REQUEST, (999.0,), DENIED),
        (REQUEST, (math.nan,), DENIED),
        (REQUEST, (1e30,), DENIED),
        (INTERVAL, (math.nan, 1e5), DENIED),
        (INTERVAL, (30.0, 1e5), DENIED),
        (INTERVAL, (275.0, math.nan), DENIED),
        (INTERVAL, (275.0, -7.0), DENIED),
        (INTERVAL, (math.inf, 1.0), DENIED),
        (mavlink.MAV_CMD_SET_CAMERA_MODE, (0.0, 0.0), DENIED),
        (mavlink.MAV_CMD_SET_CAMERA_MODE, (0.0, 1.0), ACCEPTED),
        (mavlink.MAV_CMD_IMAGE_START_CAPTURE, (0.0, 1.0), UNSUPPORTED),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,), UNSUPPORTED),
        (mavlink.MAV_CMD_DO_SET_MODE, (1.0, 6.0), UNSUPPORTED),
        (mavlink.MAV_CMD_PREFLIGHT_STORAGE, (1.0,), UNSUPPORTED),
        (POINT, (math.nan, 0.5), DENIED),
        (POINT, (0.5, -0.2), DENIED),
        (POINT, (320.0, 240.0), DENIED),
        (RECTANGLE, (math.nan,) * 4, DENIED),
        (RECTANGLE, (0.2, 0.2, math.inf, 0.5), DENIED),
        (RECTANGLE, (-0.5, -0.5, -0.2, -0.2), DENIED),
        (RECTANGLE, (1.2, 0.1, 1.5, 0.4), DENIED),
        (RECTANGLE, (0.4, 0.4, 0.4, 0.6), DENIED),
        (RECTANGLE, (0.4, 0.4, 0.401, 0.401), DENIED),
    ],
)
def test_what_cannot_be_done_is_refused_and_nothing_happens(
    rig: Any, qgc: Any, command: int, params: tuple[float, ...], result: int
) -> None:
    assert answer(rig, qgc, command, *params) == result
    assert rig.requests.take_target() is None
    assert not qgc.of("CAMERA_TRACKING_IMAGE_STATUS")


def test_a_refusal_says_why(rig: Any, qgc: Any) -> None:
    answer(rig, qgc, RECTANGLE, 0.4, 0.4, 0.401, 0.401)
    (text,) = qgc.of("STATUSTEXT")
    assert "too small" in text.text
    assert text.severity == mavlink.MAV_SEVERITY_WARNING


@pytest.mark.parametrize("length", [1, 50, 51, 99, 100, 101, 150])
def test_a_long_text_ends_with_a_part_that_is_not_full(length: int) -> None:
    sent: list[bytes] = []
    Endpoint(1, 100, sent.append).say("x" * length)
    parts = [mavlink.MAVLink(None).decode(bytearray(data)) for data in sent]
    assert "".join(part.text for part in parts) == "x" * length
    assert [part.chunk_seq for part in parts] == list(range(len(parts)))
    assert len(parts) == 1 or len(parts[-1].text) < 50
    assert all(len(part.text) == 50 for part in parts[:-1])


def test_a_drawn_rectangle_and_a_click_become_wishes(rig: Any, qgc: Any) -> None:
    assert answer(rig, qgc, RECTANGLE, 0.25, 0.5, 0.5, 0.75) == ACCEPTED
    request = rig.requests.take_target()
    assert request.selection == BoxSelection(0.25, 0.5, 0.5, 0.75)
    assert "255" in request.by
    assert answer(rig, qgc, POINT, 0.5, 0.25, 0.05) == ACCEPTED
    assert rig.requests.take_target().selection == PointSelection(0.5, 0.25)


def test_what_came_of_a_wish_is_told(rig: Any, qgc: Any) -> None:
    for outcome in (
        RequestOutcome(True, "the car there"),
        RequestOutcome(False, "nothing stands out there"),
    ):
        answer(rig, qgc, POINT, 0.5, 0.25 if outcome.accepted else 0.3)
        rig.requests.take_target().settle(outcome)
        rig.run(0.1)
        assert outcome.text in qgc.of("STATUSTEXT")[-1].text


def test_a_command_that_comes_again_is_answered_again_and_done_once(rig: Any, qgc: Any) -> None:
    corners = 0.25, 0.5, 0.5, 0.75
    assert answer(rig, qgc, RECTANGLE, *corners) == ACCEPTED
    assert rig.requests.take_target() is not None
    rig.run(2.0)
    assert answer(rig, qgc, RECTANGLE, *corners, confirmation=1) == ACCEPTED
    assert rig.requests.take_target() is None
    rig.run(11.0)
    assert answer(rig, qgc, RECTANGLE, *corners) == ACCEPTED
    assert rig.requests.take_target() is not None


def test_a_stop_is_carried_out_however_soon_after_another_one(rig: Any, qgc: Any) -> None:
    for confirmation in (0, 0, 1):
        assert answer(rig, qgc, STOP, confirmation=confirmation) == ACCEPTED
        assert rig.requests.take_target().selection == ClearSelection()
        assert answer(rig, qgc, POINT, 0.5, 0.25 + 0.1 * rig.now_s) == ACCEPTED
        assert isinstance(rig.requests.take_target().selection, PointSelection)


def test_the_box_streams_from_the_drawing_to_the_button_off(rig: Any, qgc: Any) -> None:
    answer(rig, qgc, RECTANGLE, 0.25, 0.5, 0.5, 0.75)
    assert answer(rig, qgc, INTERVAL, IMAGE_STATUS, 500_000) == ACCEPTED
    rig.run(4.0, lambda _: rig.show(Box(320, 240, 64, 48)))
    statuses = qgc.of("CAMERA_TRACKING_IMAGE_STATUS", 100)
    assert 8 <= len(statuses) <= 9
    newest = statuses[-1]
    assert newest.tracking_status == 1
    assert newest.tracking_mode == mavlink.CAMERA_TRACKING_MODE_RECTANGLE
    corners = newest.rec_top_x, newest.rec_top_y, newest.rec_bottom_x, newest.rec_bottom_y
    assert corners == pytest.approx((0.45, 0.45, 0.55, 0.55))
    assert answer(rig, qgc, STOP) == ACCEPTED
    rig.run(1.0, lambda _: rig.show(None))
    assert qgc.of("CAMERA_TRACKING_IMAGE_STATUS")[-1].tracking_status == 0
    assert answer(rig, qgc, INTERVAL, IMAGE_STATUS, -1) == ACCEPTED
    count = len(qgc.of("CAMERA_TRACKING_IMAGE_STATUS"))
    rig.run(2.0)
    assert len(qgc.of("CAMERA_TRACKING_IMAGE_STATUS")) == count


@pytest.mark.parametrize(
    ("state", "active_only", "status"),
    [
        (TrackState.TRACKING, False, 1),
        (TrackState.COASTING, True, 1),
        (TrackState.COASTING, False, 9),
        (TrackState.LOST, True, 0),
        (TrackState.LOST, False, 2),
    ],
)
def test_what_each_state_of_the_track_is_told_as(
    make_rig: MakeRig, state: TrackState, active_only: bool, status: int
) -> None:
    rig = make_rig(active_only=active_only)
    qgc = rig.station_peer()
    rig.show(Box(320, 240, 64, 48), state)
    answer(rig, qgc, REQUEST, IMAGE_STATUS)
    assert qgc.of("CAMERA_TRACKING_IMAGE_STATUS")[-1].tracking_status == status


def test_a_picture_that_stands_still_has_no_box(rig: Any, qgc: Any) -> None:
    rig.show(Box(320, 240, 64, 48))
    rig.run(1.5)
    answer(rig, qgc, REQUEST, IMAGE_STATUS)
    assert qgc.of("CAMERA_TRACKING_IMAGE_STATUS")[-1].tracking_status == 0


def test_the_interval_can_be_asked_for_and_zero_is_the_usual_one(make_rig: MakeRig) -> None:
    rig = make_rig(image_rate_hz=4.0)
    qgc = rig.station_peer()
    asked = mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
    answer(rig, qgc, asked, IMAGE_STATUS)
    answer(rig, qgc, INTERVAL, IMAGE_STATUS, 0.0)
    rig.run(1.1)
    answer(rig, qgc, asked, IMAGE_STATUS)
    answer(rig, qgc, asked, 33)
    assert [one.interval_us for one in qgc.of("MESSAGE_INTERVAL")] == [-1, 250_000, 0]


def test_an_interval_that_cannot_be_told_is_refused(rig: Any, qgc: Any) -> None:
    assert answer(rig, qgc, INTERVAL, IMAGE_STATUS, 3e9) == DENIED
    assert answer(rig, qgc, INTERVAL, IMAGE_STATUS, 2e9) == ACCEPTED
    answer(rig, qgc, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, IMAGE_STATUS)
    assert qgc.of("MESSAGE_INTERVAL")[-1].interval_us == 2_000_000_000


def test_a_geo_status_without_a_place_has_no_numbers(rig: Any, qgc: Any) -> None:
    rig.show(Box(320, 240, 64, 48))
    answer(rig, qgc, REQUEST, GEO_STATUS)
    (status,) = qgc.of("CAMERA_TRACKING_GEO_STATUS")
    assert (status.lat, status.lon) == (2**31 - 1, 2**31 - 1)
    assert math.isnan(status.dist)


def test_commands_to_others_are_left_to_them(rig: Any, qgc: Any) -> None:
    for component in (0, 1, 101, 154):
        qgc.command(RECTANGLE, 0.25, 0.5, 0.5, 0.75, component=component)
    rig.run(0.2)
    assert rig.requests.take_target() is None
    assert not qgc.of("COMMAND_ACK", 100)


def test_the_autopilot_asks_once_a_second_as_ardupilot_does(rig: Any) -> None:
    rig.autopilot.command(REQUEST, 259)
    rig.run(0.1)
    assert rig.autopilot.of("CAMERA_INFORMATION", 100)
    rig.autopilot.command(RECTANGLE, 0.25, 0.5, 0.5, 0.75)
    rig.run(0.1)
    assert rig.requests.take_target() is not None


def test_another_camera_of_the_same_number_silences_ours(rig: Any) -> None:
    qgc, other = rig.station_peer(), rig.peer(1, 100)
    rig.run(0.1)
    before = len(qgc.of("HEARTBEAT", 100))
    other.command(POINT, 0.5, 0.5)
    rig.run(3.0)
    assert len(qgc.of("HEARTBEAT", 100)) == before
    assert any("camera_component" in note for note in rig.requests.take().notes)


def test_one_that_comes_later_or_pretends_does_not_silence_ours(rig: Any, qgc: Any) -> None:
    rig.run(4.0)
    forged = rig.peer(1, 100)
    rig.run(0.1)
    before = len(qgc.of("HEARTBEAT", 100))
    for _ in range(5):
        forged.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_CAMERA, 8, 0, 0, 4, 3))
        rig.run(1.0)
    assert len(qgc.of("HEARTBEAT", 100)) >= before + 4
    assert answer(rig, qgc, RECTANGLE, 0.25, 0.5, 0.5, 0.75) == ACCEPTED
    notes = [note for note in rig.requests.take().notes if "component 100" in note]
    assert len(notes) == 1
    assert "sign the link" in notes[0]


numbers = st.floats(width=32, allow_nan=True, allow_infinity=True)


@pytest.mark.slow
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.one_of(
        st.integers(0, 65535),
        st.sampled_from([POINT, RECTANGLE, STOP, INTERVAL, REQUEST, 521, 522, 525, 527, 2504, 510]),
    ),
    st.lists(numbers, min_size=7, max_size=7),
    st.integers(0, 255),
)
def test_any_command_whatever_is_answered_just_once(
    make_rig: MakeRig, command: int, params: list[float], confirmation: int
) -> None:
    rig = make_rig(video_uri=VIDEO)
    qgc = rig.station_peer()
    before = len(qgc.of("COMMAND_ACK"))
    qgc.command(command, *params, confirmation=confirmation)
    rig.run(0.06)
    assert len(qgc.of("COMMAND_ACK")) == before + 1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_that_ends_it_is_told(rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:

    def fail(*_: float) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(rig.station, "step", fail)
    rig.station.start()
    rig.station._thread.join(60.0)
    assert any("nobody answers" in note for note in rig.requests.take().notes)


def packet(message_id: int, payload: bytes, version: int, component: int) -> bytes:
    """Return a packet of MAVLink 1 or 2 with any payload and the right checksum."""
    extra = crc_extra_of(message_id)
    assert extra is not None
    if version == 1:
        head = bytes((0xFE, len(payload), 0, 255, component, message_id & 0xFF))
    else:
        head = bytes((0xFD, len(payload), 0, 0, 0, 255, component))
        head += message_id.to_bytes(3, "little")
    return head + payload + checksum(head + payload, extra)


payloads = st.binary(max_size=255) | st.binary(max_size=40).map(
    lambda data: bytes((1, 100)) + data.ljust(20, b"\1")
)


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.sampled_from(sorted(HEARD)), payloads), max_size=4))
def test_any_content_whatever_is_survived(
    make_rig: MakeRig, version: int, packets: list[tuple[int, bytes]]
) -> None:
    rig = make_rig(video_uri="rtsp://10.0.0.5/live")
    peer = rig.peer()
    for message_id, payload in packets:
        if version == 2 or message_id < 256:
            peer._socket.sendto(packet(message_id, payload, version, 190), peer._address)
    rig.run(0.06)
    rig.everybody.append(peer)
    before = len(peer.of("CAMERA_INFORMATION"))
    peer.command(REQUEST, 259)
    rig.run(0.06)
    assert len(peer.of("CAMERA_INFORMATION")) >= before + 1
