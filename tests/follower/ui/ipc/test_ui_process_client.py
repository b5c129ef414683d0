"""The process beside the flight: whatever becomes of it, the flight goes on."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from certificates import make_certificate
from waiting import until

from follower.flight.operator_requests import OperatorRequests
from follower.flight.supervision.inputs import ConsentRequest
from follower.settings.settings import Settings, load_settings
from follower.settings.ui import VideoSettings
from follower.ui.cockpit.publisher import FlightOperator, initial_state
from follower.ui.cockpit.start import open_station
from follower.ui.cockpit.video_pipeline import VideoPipeline
from follower.ui.ipc.messages import Wire, WireError
from follower.ui.ipc.server_client import Outbox, SharedImage, UiProcessClient
from follower.ui.video.channel import Picture
from follower_control.common.strict_config import SettingsError
from follower_vision.images.frame import Frame

PATIENCE_S = 30.0
IMAGE = np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3)


# What it is made of.


def test_an_image_goes_through_shared_memory_and_grows() -> None:
    ours = SharedImage(os.memfd_create("test"))
    theirs = SharedImage(os.dup(ours.descriptor))
    with pytest.raises(ValueError, match="no image yet"):
        theirs.read(12, 16)
    for image in (IMAGE, np.repeat(IMAGE, 3, 0), IMAGE + 1):
        ours.write(image)
        height, width = image.shape[:2]
        np.testing.assert_array_equal(theirs.read(height, width), image)
    with pytest.raises(ValueError, match="no image has"):
        theirs.read(1_000_000, 1_000_000)
    ours.close()
    theirs.close()


def test_the_outbox_keeps_the_newest_and_sends_pictures_when_they_are_wanted() -> None:
    outbox = Outbox()
    outbox.state({"kind": "state", "state": 1})
    outbox.state({"kind": "state", "state": 2})
    outbox.tell({"kind": "page"})
    outbox.show(Picture(IMAGE, 1, 0.1))
    first = outbox.wait()
    assert first == ([{"kind": "page"}, {"kind": "state", "state": 2}], None)
    outbox.picture_wanted()
    outbox.show(Picture(IMAGE, 2, 0.2))
    second = outbox.wait()
    assert second[1].sequence == 2
    outbox.close()
    assert outbox.wait() is None


def test_a_line_carries_messages_and_refuses_the_rest() -> None:
    ours, theirs = (Wire(end, 100) for end in Pipe())
    ours.send({"kind": "heard"})
    assert theirs.receive() == {"kind": "heard"}
    for wrong in ([1], {"no": "kind"}, {"kind": 3}):
        ours.send(wrong)  # type: ignore[arg-type]
        with pytest.raises(WireError):
            theirs.receive()
    with pytest.raises(ValueError, match="JSON"):
        ours.send({"kind": "state", "value": float("nan")})
    ours.send({"kind": "x" * 200})
    with pytest.raises(OSError, match="bad message length"):
        theirs.receive()
    ours.close()


def test_hanging_up_ends_a_waiting_receiver() -> None:
    ours, theirs = (Wire(end, 100) for end in Pipe())
    ended = threading.Event()

    def receive() -> None:
        try:
            theirs.receive()
        except (OSError, EOFError):
            ended.set()

    thread = threading.Thread(target=receive)
    thread.start()
    time.sleep(0.05)
    theirs.hang_up()
    assert ended.wait(PATIENCE_S)
    thread.join()
    theirs.close()
    ours.close()


# What operators ask for.


@pytest.fixture
def requests() -> OperatorRequests:
    return OperatorRequests(Settings())


def asked(operator: FlightOperator, **request: Any) -> Any:
    return operator.ask({"number": 1, **request}, "cockpit")


def test_requests_come_to_where_every_front_end_puts_them(requests: OperatorRequests) -> None:
    heard = list[bool]()
    operator = FlightOperator(requests, lambda: heard.append(True))
    assert asked(operator, kind="stop")["accepted"]
    assert asked(operator, kind="consent", given=True)["accepted"]
    assert asked(operator, kind="consent", given=False)["accepted"]
    assert asked(operator, kind="change", key="servo.azimuth.kp", value=1.25)["accepted"]
    operator.heard()
    taken = requests.take()
    assert taken.stop
    assert list(taken.orders) == [ConsentRequest.GIVE, ConsentRequest.WITHDRAW]
    assert taken.settings.servo.azimuth.kp == 1.25
    assert heard == [True]


def test_a_target_is_answered_when_vision_has_looked(requests: OperatorRequests) -> None:
    from follower.flight.target.request import RequestOutcome

    operator = FlightOperator(requests, lambda: None)
    assert asked(operator, kind="select_point", x=0.25, y=0.5) is None
    assert list(operator.late_answers()) == []
    target = requests.take_target()
    target.settle(RequestOutcome(True, "the car there"))
    (answer,) = operator.late_answers()
    assert answer == {"kind": "answer", "number": 1, "accepted": True, "text": "the car there"}
    assert list(operator.late_answers()) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "arm"},
        {"kind": "stop", "more": 1},
        {"kind": "select_point", "x": 7, "y": 0},
        {"kind": "change", "key": "autonomy", "value": "full"},
        {"kind": "change", "key": "envelope.max_speed_m_s", "value": 99.0},
        {"kind": "change", "key": "envelope.max_acceleration_m_s2", "value": 1.0},
        {"kind": "change", "key": "consent.kind", "value": "mode"},
        {"kind": "change", "key": "servo.azimuth.kp", "value": "much"},
        {"kind": "show", "flight": "x"},
    ],
)
def test_what_the_stations_process_says_is_checked_again(
    requests: OperatorRequests, wrong: dict[str, Any]
) -> None:
    operator = FlightOperator(requests, lambda: None)
    assert asked(operator, **wrong)["accepted"] is False
    taken = requests.take()
    assert not taken.stop
    assert taken.settings is None


# The process.


@pytest.fixture
def station(tmp_path: Any) -> Iterator[tuple[UiProcessClient, list[str]]]:
    settings = load_settings(None, None, ("video.rtsp=127.0.0.1:0",))
    said: list[str] = []
    station = open_station(
        settings, False, initial_state("fly", "", settings), tmp_path, said.append
    )
    yield station, said
    station.close()


def test_nothing_is_started_where_nothing_is_wanted(tmp_path: Any) -> None:
    threads, children = threading.active_count(), child_processes()
    assert open_station(Settings(), False, {}, tmp_path, print) is None
    assert (threading.active_count(), child_processes()) == (threads, children)


def child_processes() -> str:
    task = Path(f"/proc/self/task/{threading.get_native_id()}/children")
    return task.read_text("utf-8")


def test_a_flight_without_the_extra_says_what_to_install(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("follower.ui.terminal.console.find_spec", lambda _: None)
    with pytest.raises(SettingsError, match=r"in the clone: pip install -e '\.\[cockpit\]'"):
        open_station(Settings(), True, {}, tmp_path, print)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("cockpit.token_file=nowhere", "token_file"),
        ("cockpit.token_file=short", "at least 12"),
        ("cockpit={tls_cert: nowhere, tls_key: nowhere}", "tls_cert"),
        ("cockpit={tls_cert: short, tls_key: short}", "tls_cert"),
    ],
)
def test_a_token_or_certificate_that_cannot_be_used_is_refused_before_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, override: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short").write_text("secret\n", "utf-8")
    settings = load_settings(None, None, (override,))
    with pytest.raises(SettingsError, match=words):
        open_station(settings, True, {}, tmp_path, print)


def test_an_encrypted_key_is_refused_and_nobody_is_asked_for_a_password(tmp_path: Path) -> None:
    make_certificate(tmp_path, b"a password")
    where = f"cockpit={{tls_cert: {tmp_path}/cert.pem, tls_key: {tmp_path}/key.pem}}"
    settings = load_settings(None, None, (where,))
    with pytest.raises(SettingsError, match=r"tls_key: it is encrypted.*openssl pkey"):
        open_station(settings, True, {}, tmp_path, print)


@pytest.mark.slow
def test_a_port_that_is_taken_is_told_with_what_to_do(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        where = f"127.0.0.1:{other.getsockname()[1]}"
        settings = load_settings(None, None, (f"video.rtsp={where}",))
        said: list[str] = []
        page = initial_state("fly", "", settings)
        station = open_station(settings, False, page, tmp_path, said.append)
        assert station is not None
        with station:
            until(lambda: said)
    assert where in said[0]
    assert "a free port" in said[0]


def test_video_alone_needs_no_web_server(station: tuple[UiProcessClient, list[str]]) -> None:
    one, said = station
    until(lambda: any("rtsp://" in line for line in said))
    maps = Path(f"/proc/{one.process_id}/maps").read_text("utf-8")
    assert "pydantic_core" in maps
    assert "srtp" not in maps
    assert os.getpriority(os.PRIO_PROCESS, one.process_id) > os.getpriority(os.PRIO_PROCESS, 0)


def test_a_terminal_that_hangs_does_not_hold_up_what_the_process_asks_for(tmp_path: Any) -> None:
    hangs, goes_on = threading.Event(), threading.Event()

    def say(_line: str) -> None:
        hangs.set()
        goes_on.wait(PATIENCE_S)

    settings = load_settings(None, None, ("video.rtsp=127.0.0.1:0",))
    one = open_station(settings, False, initial_state("fly", "", settings), tmp_path, say)
    assert hangs.wait(PATIENCE_S)
    for number in range(4):  # it asks for each picture
        one.add(Frame(IMAGE, number / 30, number), (), ())
        until(lambda: one._outbox._picture is None)
    goes_on.set()
    one.close()


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_process_that_dies_or_hangs_holds_nobody_up(
    station: tuple[UiProcessClient, list[str]], how: signal.Signals, late_s: Callable[[], float]
) -> None:
    one, said = station
    until(lambda: said)
    os.kill(one.process_id, how)
    longest_s = 0.0
    for number in range(300):
        begin_s = time.monotonic()
        one.add(Frame(IMAGE, number / 30, number), (), ())
        one.show({"text": "x" * 10_000})
        longest_s = max(longest_s, time.monotonic() - begin_s)
    assert longest_s < 0.5 + late_s()
    if how is signal.SIGKILL:
        until(lambda: "The station ended during the flight" in said[-1])


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_page_that_nobody_hears_any_more_does_not_go_on(
    station: tuple[UiProcessClient, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    one, said = station
    until(lambda: said)
    monkeypatch.setattr(one._outbox, "picture_wanted", fail)
    one.add(Frame(IMAGE, 0.0, 0), (), ())
    until(lambda: "error on our side" in said[-1])
    until(lambda: one._process.poll() is not None)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_page_that_is_told_nothing_any_more_does_not_go_on(
    station: tuple[UiProcessClient, list[str]],
) -> None:
    one, said = station
    until(lambda: said)
    too_large = np.broadcast_to(np.uint8(0), (10_000, 10_000, 3))
    one.add(Frame(too_large, 0.0, 0), (), ())
    until(lambda: "The station ended during the flight" in said[-1])
    until(lambda: one._process.poll() is not None)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_picture_that_ends_the_video_is_told_of() -> None:
    def fail(_: Picture) -> None:
        raise ZeroDivisionError

    said: list[str] = []
    studio = VideoPipeline(VideoSettings())
    studio.start_senders(said.append)
    studio.on_picture = fail
    message = {"sequence": 0, "captured_s": 0.0, "tracks": [], "lines": []}
    studio.take(message, IMAGE, lambda: None)
    until(lambda: said)
    assert "No video any more" in said[0]


@pytest.mark.slow
def test_it_ends_with_the_flight(
    station: tuple[UiProcessClient, list[str]], late_s: Callable[[], float]
) -> None:
    one, said = station
    until(lambda: said)
    begin_s = time.monotonic()
    one.close()
    assert time.monotonic() - begin_s < 2.5 + late_s()
    assert one.remark is None
