"""The cockpit's server against people who mean it ill, are many, or are slow."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from cockpit_client import (
    CONSENT,
    PATIENCE_S,
    connect,
    get,
    message,
    noise_frame,
    post,
    say,
    state,
    ws,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from waiting import until
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from follower.settings.ui import CockpitSettings
from follower.ui.cockpit.hub import Hub
from follower.ui.cockpit.requests import REQUESTS
from follower_vision.clock import SimulatedClock

# Who is in control.


def test_one_controls_the_others_watch_and_anybody_may_stop(served: Any) -> None:
    before = len(served.station.operator.asked)
    with connect(ws(served)) as first, connect(ws(served)) as second:
        assert message(first, "control")["yours"]
        assert not message(second, "control")["yours"]
        say(second, kind="take_control")
        say(second, kind="select_point", x=0.5, y=0.5, id=1)
        answer = message(second, "answer")
        assert not answer["accepted"]
        assert "in control" in answer["text"]
        say(second, kind="consent", given=True, id=2)
        assert not message(second, "answer")["accepted"]
        say(second, kind="stop", id=3)
        assert message(second, "answer")["accepted"]
        say(second, kind="consent", given=False, id=4)
        assert message(second, "answer")["accepted"]
        say(first, kind="select_point", x=0.5, y=0.5, id=1)
        assert message(first, "answer")["accepted"]
        first.close()
        until(lambda: not message(second, "control")["taken"])
        with connect(ws(served)) as newcomer:
            assert not message(newcomer, "control")["taken"]
        say(second, kind="take_control")
        until(lambda: message(second, "control")["yours"])
    asked = [request["kind"] for request in served.station.operator.asked[before:]]
    assert asked == ["stop", "consent", "select_point"]


def test_what_was_asked_before_somebody_let_go_comes_too_late(served: Any) -> None:
    """A line that broke may hand over a consent when STOP has come another way long since."""
    with connect(ws(served)) as client:
        message(client, "hello")
        seen_s = message(client, "state")["at"]
        assert post(f"{served.url}/api/request", json={"kind": "stop"}).json()["accepted"]
        say(client, kind="consent", given=True, id=1, at=seen_s)
        answer = message(client, "answer")
        assert not answer["accepted"]
        assert "stopped since you asked" in answer["text"]
        say(client, kind="consent", given=False, id=2, at=seen_s)
        assert message(client, "answer")["accepted"]
        served.station.show(state(time_s=1.0))
        say(client, kind="consent", given=True, id=3, at=message(client, "state")["at"])
        assert message(client, "answer")["accepted"]


def test_a_time_that_is_none_gets_an_answer_like_no_time(served: Any) -> None:
    with connect(ws(served)) as client:
        message(client, "hello")
        for number, at in enumerate((10**400, "soon", None)):
            say(client, kind="select_point", x=0.5, y=0.5, id=number, at=at)
            assert message(client, "answer")["accepted"]


def test_what_was_asked_long_ago_is_refused_but_for_letting_go() -> None:
    clock = SimulatedClock()
    hub = Hub({}, lambda _: None, clock, 4)
    clock.sleep_until(10.0)
    assert hub.lateness(CONSENT, 9.0) is None
    assert "late" in str(hub.lateness(CONSENT, 6.0))
    assert hub.lateness(REQUESTS.validate_python({"kind": "stop"}), 0.0) is None


def test_who_comes_later_is_told_how_old_the_state_is() -> None:
    """A page that is loaded while control hangs is not to show its last state as live."""
    clock = SimulatedClock()
    hub = Hub({}, lambda _: None, clock, 4)
    hub.take({"kind": "state", "state": state(time_s=1.0)})
    clock.sleep_until(60.0)
    hub.take({"kind": "state", "state": state(time_s=1.0)})
    client = hub.join()
    told = [json.loads(text) for text in asyncio.run(client.next())]
    (moment,) = [one for one in told if one["kind"] == "state"]
    assert moment["at"] - moment["told_s"] == 60.0


def test_a_stop_is_carried_out_however_many_wait_for_answers(
    served: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(served.station.operator, "answers", False)
    stops = stops_asked(served)
    with connect(ws(served), max_queue=None) as client:
        message(client, "hello")
        for number in range(30):
            say(client, kind="select_point", x=0.5, y=0.5, id=number)
        say(client, kind="stop", id=99)
        until(lambda: stops_asked(served) > stops)


def stops_asked(served: Any) -> int:
    return sum(one["kind"] == "stop" for one in served.station.operator.asked)


def test_who_says_that_he_is_there_hears_the_same(served: Any) -> None:
    with connect(ws(served)) as client:
        message(client, "hello")
        say(client, kind="ping")
        assert message(client, "pong") == {"kind": "pong"}


def test_by_http_too_only_who_controls_may_ask(served: Any) -> None:
    url = f"{served.url}/api/request"
    wish = {"kind": "change", "key": "servo.azimuth.kp", "value": 1.0}
    assert post(url, json=wish).status_code == 409
    assert post(url, json=wish, headers={"x-client": "guessed"}).status_code == 409
    assert post(url, json={"kind": "stop"}).json()["accepted"]
    with connect(ws(served)) as client:
        name = message(client, "hello")["client"]
        assert post(url, json=wish, headers={"x-client": name}).json()["accepted"]
    until(lambda: post(url, json=wish, headers={"x-client": name}).status_code == 409)


def test_the_flight_hears_of_the_client_in_control(served: Any) -> None:
    before = served.station.operator.heard_times
    with connect(ws(served)) as client:
        message(client, "hello")
        say(client, kind="ping")
        until(lambda: served.station.operator.heard_times > before)


# What is no request.

RUDE = [
    "",
    "{",
    "[]",
    "1",
    '"stop"',
    "null",
    "[" * 2000,
    '{"kind": "change"}',
    '{"kind": ["stop"], "id": {}}',
    "x" * 3000,
    "x" * 100_000,
    '{"kind": "stop", "id": "one"}',
    '{"kind": "stop", "id": 1e400}',
    b"\x00\xff",
    b'{"kind": "stop", "id": 1}',
]


def is_hung_up_on(client: ClientConnection) -> bool:
    try:
        for _ in range(2000):
            client.recv(PATIENCE_S)
    except ConnectionClosed:
        return True
    return False


@pytest.mark.parametrize("text", RUDE, ids=[repr(one)[:30] for one in RUDE])
def test_rudeness_ends_the_conversation_and_nothing_else(served: Any, text: str | bytes) -> None:
    asked = len(served.station.operator.asked)
    with connect(ws(served)) as rude:
        message(rude, "hello")
        rude.send(text)
        assert is_hung_up_on(rude)
    assert len(served.station.operator.asked) == asked
    assert get(f"{served.url}/api/state").status_code == 200


REFUSED = [
    {"kind": "arm"},
    {"kind": "select_point", "x": 2.0, "y": 0.5},
    {"kind": "select_point", "x": None, "y": 0.5},
    {"kind": "select_box", "left": 0.1, "top": 0.1, "right": 0.2},
    {"kind": "consent", "given": "yes"},
    {"kind": "consent", "given": 1},
    {"kind": "stop", "force": True},
    {"kind": "change", "key": "servo.azimuth.kp", "value": None},
    {"kind": "change", "key": "servo.azimuth.kp", "value": 1e300},
    {"kind": "change", "key": "../../etc", "value": 1},
    {"kind": "change", "key": "x" * 200, "value": 1},
    {"kind": "heard"},
    {"kind": "request", "request": {"kind": "stop"}},
]


@pytest.mark.parametrize("wish", REFUSED, ids=[str(wish)[:60] for wish in REFUSED])
def test_what_is_no_request_is_refused_before_it_gets_to_the_flight(
    served: Any, wish: dict[str, Any]
) -> None:
    asked = len(served.station.operator.asked)
    with connect(ws(served)) as client:
        message(client, "hello")
        say(client, **wish, id=7)
        answer = message(client, "answer")
    assert answer["id"] == 7
    assert not answer["accepted"]
    assert post(f"{served.url}/api/request", json=wish).status_code == 422
    assert len(served.station.operator.asked) == asked


def test_not_a_number_is_no_number(served: Any) -> None:
    with connect(ws(served)) as client:
        message(client, "hello")
        for bad in ("NaN", "Infinity", "1e999"):
            wish = f'"kind": "change", "key": "servo.azimuth.kp", "value": {bad}, "id": 1'
            client.send("{" + wish + "}")
            assert not message(client, "answer")["accepted"]


def test_a_flood_is_cut_off(served: Any) -> None:
    with connect(ws(served)) as flood:
        with contextlib.suppress(ConnectionClosed):
            for _ in range(5000):
                flood.send('{"kind": "ping"}')
        assert is_hung_up_on(flood)


def test_a_body_that_is_too_long_is_refused(served: Any) -> None:
    long = {"sdp": "v=0\r\n" + 70_000 * "a"}
    assert post(f"{served.url}/api/webrtc", json=long).status_code == 413
    with socket.create_connection(("127.0.0.1", served.port)) as liar:
        head = (
            f"POST /api/request HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n"
            "Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"
        )
        liar.sendall(head.encode())
        liar.settimeout(PATIENCE_S)
        try:
            for _ in range(40):
                liar.sendall(b"2000\r\n" + 0x2000 * b" " + b"\r\n")
            answer = liar.recv(4096)
        except (BrokenPipeError, ConnectionResetError):
            answer = b""
    assert b" 200 " not in answer
    assert get(f"{served.url}/api/state").status_code == 200


# Names of files.


@pytest.mark.parametrize("name", ["..", "%2e%2e", "..%2f..%2fetc", ".hidden", "a%00b", "none"])
def test_no_name_leads_out_of_the_folder(served: Any, name: str) -> None:
    assert get(f"{served.url}/api/flights/{name}/report").status_code in (404, 422)


# Many, and slow.


@pytest.mark.slow
def test_all_clients_are_told_and_one_too_many_is_not_let_in(served: Any) -> None:
    most = CockpitSettings().most_clients
    assert most >= 50

    async def run() -> int:
        join = partial(connect_async, ws(served), open_timeout=PATIENCE_S, close_timeout=1)
        clients = [await join() for _ in range(most)]
        extra = await join()
        with pytest.raises(ConnectionClosed) as ended:
            await asyncio.wait_for(extra.recv(), PATIENCE_S)
        assert ended.value.rcvd.code == 1013
        await asyncio.to_thread(show_for, served, 1.5)
        newest = [await newest_time(client) for client in clients]
        await asyncio.gather(*(client.close() for client in clients))
        return sum(t is not None for t in newest)

    assert asyncio.run(run()) == most


async def newest_time(client: Any) -> float | None:
    while True:
        found = json.loads(await asyncio.wait_for(client.recv(), PATIENCE_S))
        if found["kind"] == "state" and "time_s" in found:
            return float(found["time_s"])


def show_for(served: Any, seconds: float) -> None:
    """Show states and pictures as a flight does."""
    begin_s = time.monotonic()
    number = 0
    while time.monotonic() - begin_s < seconds:
        served.station.show(state(time_s=time.monotonic() - begin_s, link="x" * 300))
        served.station.add(noise_frame(number), (), ())
        number += 1
        time.sleep(1 / 30)


@pytest.mark.slow
def test_who_does_not_read_costs_nothing_and_the_others_see_the_newest(served: Any) -> None:
    """Ten WebSockets and four videos are opened and never read."""
    stuck = [stuck_reader(served, path) for path in 10 * ["/ws"] + 4 * ["/video.mjpeg"]]
    show_for(served, 1.0)
    before_kb = resident_kb(served)
    with connect(ws(served)) as client:
        message(client, "hello")
        served.station.show(state(time_s=111.0))
        show_for(served, 2.0)
        served.station.show(state(time_s=222.0))
        begin_s = time.monotonic()
        until(lambda: message(client, "state").get("time_s") == 222.0)
        print(f"the newest state came after {time.monotonic() - begin_s:.3f} s")
    assert resident_kb(served) - before_kb < 20_000
    for one in stuck:
        one.close()


@pytest.mark.slow
def test_who_reads_slowly_gets_new_pictures_not_those_that_were_kept_for_him(serve: Any) -> None:
    """Linux would keep megabytes for a slow line: the page showed as live what was long past."""
    served = serve()
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
        slow.connect(("127.0.0.1", served.port))
        slow.sendall(b"GET /video.mjpeg HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        show_for(served, 2.0)
        slow.settimeout(PATIENCE_S)
        kept = b""
        while b"--picture" not in kept:
            kept += slow.recv(1 << 16)
        slow.settimeout(1.0)
        with contextlib.suppress(TimeoutError):
            while data := slow.recv(1 << 16):
                kept += data
    assert kept.count(b"--picture") < 10


def stuck_reader(served: Any, path: str) -> socket.socket:
    one = socket.create_connection(("127.0.0.1", served.port))
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    upgrade = (
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    )
    extra = upgrade if path == "/ws" else ""
    one.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{extra}\r\n".encode())
    return one


def resident_kb(served: Any) -> int:
    text = Path(f"/proc/{served.station.process_id}/status").read_text("ascii")
    (line,) = [line for line in text.splitlines() if line.startswith("VmRSS")]
    return int(line.split()[1])


# Everything that the interface describes of itself.


@pytest.mark.slow
def test_the_interface_does_what_it_describes(served: Any) -> None:
    """Schemathesis asks for everything, rightly and wrongly."""
    schema = schemathesis.openapi.from_url(f"{served.url}/openapi.json")
    schema.config.update(base_url=served.url)
    refusal = schema.config.checks.negative_data_rejection
    refusal.expected_statuses = [*refusal.expected_statuses, "413"]  # what is too long
    operations = [one.ok() for one in schema.get_all_operations()]
    assert {one.path for one in operations} >= {"/api/request", "/api/state", "/api/webrtc"}
    for operation in operations:
        strategies = [
            operation.as_strategy(generation_mode=mode) for mode in schemathesis.GenerationMode
        ]

        @settings(max_examples=12, suppress_health_check=list(HealthCheck))
        @given(case=st.one_of(strategies))
        def check(case: schemathesis.Case) -> None:
            case.call_and_validate()

        check()
