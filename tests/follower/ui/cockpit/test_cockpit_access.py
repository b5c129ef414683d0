"""Strangers on the network take neither the pilot's turn nor his place."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from uvicorn import Config
from uvicorn.server import ServerState
from waiting import until
from websockets.sync.client import connect

from follower.ui.cockpit import asgi_guard
from follower.ui.cockpit.app import make_app
from follower.ui.cockpit.asgi_guard import (
    ConnectionLimiter,
    RateLimiter,
    crowded_protocol,
    network_of,
)
from follower.ui.cockpit.auth import AccessControl
from follower.ui.cockpit.hub import Hub
from follower_vision.clock import SimulatedClock

TOKEN = "a token of some length"
PILOT, STRANGER = "127.0.0.1", "127.0.0.66"
STOP, DROP = {"kind": "stop"}, {"kind": "stop_tracking"}
MANY = 300
PATIENCE_S = 30.0


@pytest.fixture(scope="module")
def open_to_all(serve: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("token") / "token"
    path.write_text(TOKEN + "\n", "utf-8")
    return serve("cockpit.host=0.0.0.0", f"cockpit.token_file={path}")


def at(address: str, served: Any, **options: Any) -> httpx.Client:
    transport = httpx.HTTPTransport(local_address=address)
    return httpx.Client(base_url=served.url, transport=transport, timeout=30, **options)


def is_slowed(ask: Callable[[], int]) -> bool:
    """Whether 8 are answered, and one more for each second that a slow computer takes for them."""
    began_s, answered = time.monotonic(), 0
    while ask() != 429:
        answered += 1
        if answered > 9 + time.monotonic() - began_s:
            return False
    return True


def test_each_one_has_a_limit_of_his_own_and_few_are_kept() -> None:
    clock = SimulatedClock()
    limiter = RateLimiter(1.0, 2, clock)
    assert [limiter.allows("one") for _ in range(3)] == [True, True, False]
    assert limiter.allows("another")
    allowed = [limiter.allows(f"stranger {number}") for number in range(MANY)]
    assert not all(allowed), "those who come late share one"
    assert not limiter.allows("one"), "he is not forgotten to begin anew"
    clock.sleep_until(10.0)
    assert [limiter.allows("somebody new") for _ in range(3)] == [True, True, False]
    assert limiter.allows("yet another"), "the strangers are forgotten"


@given(st.ip_addresses(v=6), st.integers(0, 2**64 - 1))
def test_one_who_has_a_network_of_ipv6_is_one(address: Any, other: int) -> None:
    neighbour = type(address)((int(address) >> 64 << 64) | other)
    if address.ipv4_mapped is None and neighbour.ipv4_mapped is None:
        assert network_of(str(address)) == network_of(str(neighbour))


def test_an_ipv4_address_is_one_however_it_is_written() -> None:
    assert network_of("::ffff:10.0.0.7") == network_of("10.0.0.7") != network_of("10.0.0.8")
    assert network_of("fe80::1%eth0") == network_of("fe80::2%eth0")


@pytest.mark.slow
def test_who_guesses_tokens_slows_himself_alone(open_to_all: Any) -> None:
    with at(STRANGER, open_to_all) as stranger, at(PILOT, open_to_all) as pilot:
        guess = {"token": "a guess"}
        assert is_slowed(lambda: stranger.post("/api/session", json=guess).status_code)
        assert pilot.post("/api/session", json={"token": TOKEN}).status_code == 204
        assert pilot.post("/api/request", json=STOP).json()["accepted"]


@pytest.mark.slow
def test_tokens_in_headers_cannot_be_guessed_faster(open_to_all: Any) -> None:
    stranger = "127.0.0.67"
    with at(stranger, open_to_all) as one, at(stranger, open_to_all) as pilots_page:
        assert pilots_page.post("/api/session", json={"token": TOKEN}).status_code == 204
        wrong, right = ({"authorization": f"Bearer {one}"} for one in ("guessed", TOKEN))

        def ask(headers: dict[str, str]) -> int:
            return one.get("/api/state", headers=headers).status_code

        assert ask(wrong) == 401
        # Nor is it told when right, unless a slow computer has given a guess back meanwhile.
        until(lambda: is_slowed(lambda: ask(wrong)) and ask(right) == 429)
        assert pilots_page.get("/api/state").status_code == 200, "who is known is not slowed"
    with at(PILOT, open_to_all) as script:
        assert script.get("/api/state", headers=right).status_code == 200


def bare_client(send: Callable[[dict[str, Any]], None]) -> httpx.AsyncClient:
    """Return a client of a cockpit in this process; what goes wrong inside is raised here."""
    clock = SimulatedClock()
    nothing: Any = None
    app = make_app(
        hub=Hub({}, send, clock, 4),
        access=AccessControl(None),
        jpegs=nothing,
        peers=nothing,
        flights=nothing,
        objects=None,
        clock=clock,
        secure=False,
    )
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://127.0.0.1")


@pytest.mark.slow
def test_stop_is_never_put_off() -> None:
    """However much the same client has asked for before, and whoever waits for answers."""
    told: list[dict[str, Any]] = []

    async def run() -> None:
        async with bare_client(told.append) as client:

            async def ask(**wish: Any) -> int:
                return (await client.post("/api/request", json=wish)).status_code

            codes = [await ask(**DROP) for _ in range(101)]
            assert (codes[0], codes[-1]) == (409, 429)
            waiting = [asyncio.create_task(ask(**STOP)) for _ in range(MANY)]
            withdrawal = asyncio.create_task(ask(kind="consent", given=False))
            async with asyncio.timeout(PATIENCE_S):
                while len(told) < MANY + 1:
                    await asyncio.sleep(0.01)
            for task in (*waiting, withdrawal):
                task.cancel()

    asyncio.run(run())
    kinds = [one["request"]["kind"] for one in told]
    assert (kinds.count("stop"), kinds.count("consent")) == (MANY, 1)


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/api/request", b"NaN"),
        ("/api/request", b'{"kind": "select_point", "x": NaN, "y": 0.5}'),
        ("/api/request", rb'{"kind": "\ud800"}'),
        ("/api/request", rb'{"kind": "stop", "\ud800": 1}'),
        ("/api/session", b'{"token": 1e999}'),
    ],
)
def test_what_json_cannot_say_again_is_refused_in_words(path: str, body: bytes) -> None:
    told: list[dict[str, Any]] = []

    async def refusal() -> httpx.Response:
        async with bare_client(told.append) as client:
            headers = {"content-type": "application/json"}
            return await client.post(path, content=body, headers=headers)

    answer = asyncio.run(refusal())
    assert answer.status_code == 422
    assert answer.json()["detail"][0]["msg"]
    assert not told


@pytest.mark.slow
def test_connections_of_one_address_leave_room_for_others(open_to_all: Any) -> None:
    where = (PILOT, open_to_all.port)
    lines = [socket.create_connection(where, source_address=(STRANGER, 0)) for _ in range(100)]
    with at(PILOT, open_to_all) as pilot:
        assert pilot.get("/").status_code == 200
        pilot.post("/api/session", json={"token": TOKEN})
        cookie = "; ".join(f"{name}={value}" for name, value in pilot.cookies.items())
        url = open_to_all.url.replace("http", "ws") + "/ws"
        with connect(url, open_timeout=60, additional_headers={"cookie": cookie}) as page:
            assert page.recv(30)
    shut = sum(is_hung_up_on(line, 0.05) for line in lines)
    for line in lines:
        line.close()
    assert 30 <= shut < 100


def test_nonsense_from_the_network_is_not_collected(served: Any) -> None:
    """Each was a line in the process's error file, which is in memory where /tmp is."""
    errors = Path(f"/proc/{served.station.process_id}/fd/2")
    before = errors.stat().st_size
    for _ in range(20):
        with socket.create_connection(("127.0.0.1", served.port)) as one:
            one.sendall(b"\x00\xff\r\n\r\n")
            assert b" 400 " in one.recv(4096)
    assert errors.stat().st_size == before


def test_a_body_that_does_not_come_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asgi_guard, "_BODY_WITHIN_S", 0.2)

    async def slow() -> AsyncIterator[bytes]:
        yield b"{"
        await asyncio.sleep(PATIENCE_S)

    async def run() -> httpx.Response:
        async with bare_client(print) as client:
            headers = {"content-type": "application/json", "content-length": "50"}
            answer = client.post("/api/session", content=slow(), headers=headers)
            return await asyncio.wait_for(answer, PATIENCE_S / 2)

    assert asyncio.run(run()).status_code == 400


def test_who_asks_for_nothing_is_hung_up_on() -> None:
    """But not who has asked, be it long ago."""

    async def answer(scope: Any, receive: Any, send: Any) -> None:
        del scope, receive
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body"})

    async def run() -> None:
        config = Config(answer, log_config=None, interface="asgi3")
        config.load()
        made = crowded_protocol(ConnectionLimiter(2), 0.2)
        loop = asyncio.get_running_loop()
        server = await loop.create_server(lambda: made(config, ServerState(), {}), PILOT, 0)
        where = server.sockets[0].getsockname()
        await asyncio.to_thread(meet, where)
        server.close()

    def meet(where: tuple[str, int]) -> None:
        with socket.create_connection(where, PATIENCE_S) as asking, socket.socket() as slow:
            asking.sendall(b"GET / HTTP/1.1\r\nHost: here\r\n\r\n")
            assert b"204" in asking.recv(4096)
            slow.connect(where)
            slow.sendall(b"GET / HTTP/1.1\r\n")
            with socket.create_connection(where) as one_too_many:
                assert is_hung_up_on(one_too_many)
            assert is_hung_up_on(slow)
            asking.sendall(b"GET / HTTP/1.1\r\nHost: here\r\n\r\n")
            assert b"204" in asking.recv(4096)

    asyncio.run(run())


def is_hung_up_on(line: socket.socket, patience_s: float = PATIENCE_S) -> bool:
    line.settimeout(patience_s)
    try:
        return line.recv(1) == b""
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False
