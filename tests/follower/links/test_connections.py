"""Connection strings: TCP on loopback, serial over a pair of pseudo-terminals, and what fails."""

import errno
import os
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest
from waiting import until

from follower.links import connections
from follower.links.connections import (
    ConnectionFailedError,
    SerialTransport,
    TcpTransport,
    _StreamTransport,
    open_connection,
)
from follower.links.packet_channel import PacketChannel
from follower_control.common.transport import Transport, UdpTransport
from follower_vision.clock import SimulatedClock


def _receive(transport: Transport, wanted: int = 1) -> bytes:
    data = b""
    for _ in range(2000):
        data += transport.receive()
        if len(data) >= wanted:
            break
        time.sleep(0.001)
    return data


@pytest.mark.parametrize(
    "text", ["", "udpin", "udpin:14540", "tcp:h:1:2", "COM3", "serial:ttyACM0:57600", "/dev/x:fast"]
)
def test_what_is_no_connection_is_answered_with_examples(text: str) -> None:
    with pytest.raises(ConnectionFailedError, match=r"udpin:HOST:PORT.*/dev/ttyACM0:57600"):
        open_connection(text)


def test_a_port_that_there_is_not_is_told() -> None:
    with pytest.raises(ConnectionFailedError, match="between 1 and 65535"):
        open_connection("udpin:h:99999")


@pytest.mark.parametrize(("listens", "calls"), [("tcpin", "tcp"), ("udpin", "udpout")])
def test_bytes_go_both_ways(listens: str, calls: str, free_port: Callable[[], int]) -> None:
    port = free_port()
    with (
        closing(open_connection(f"{listens}:127.0.0.1:{port}")) as server,
        closing(open_connection(f"{calls}:127.0.0.1:{port}")) as client,
    ):
        server.send(b"nobody is there yet")
        client.send(b"hello")
        assert _receive(server, 5) == b"hello"
        server.send(b"answer")
        assert _receive(client, 6) == b"answer"


def test_tcp_is_taken_up_again_after_it_broke() -> None:
    clock = SimulatedClock()
    server = TcpTransport.listen("127.0.0.1", 0)
    client = TcpTransport.connect("127.0.0.1", server.port, clock)
    client.send(b"first")
    assert _receive(server, 5) == b"first"
    assert server._file is not None
    server._drop()  # the autopilot is restarted
    for _ in range(100):
        client.receive()
        time.sleep(0.001)
    client.send(b"lost")
    clock.sleep_until(1.5)
    client.receive()
    time.sleep(0.05)
    client.send(b"again")
    assert _receive(server, 5) == b"again"
    client.close()
    server.close()


def test_who_calls_takes_the_place_of_a_tcp_peer_that_went_without_a_word() -> None:
    clock = SimulatedClock()
    with (
        closing(TcpTransport.listen("127.0.0.1", 0, clock)) as server,
        socket.create_connection(("127.0.0.1", server.port)) as without_power,
    ):
        without_power.send(b"before")
        assert _receive(server, 6) == b"before"
        with socket.create_connection(("127.0.0.1", server.port)) as restarted:
            restarted.send(b"after")
            clock.sleep_until(2.0)
            assert server.receive() == b""  # it may be heard again
            clock.sleep_until(4.0)
            assert _receive(server, 5) == b"after"
            server.send(b"answer")
            restarted.settimeout(1.0)
            assert restarted.recv(6) == b"answer"


def test_a_tcp_peer_that_does_not_read_loses_whole_packets_and_blocks_nobody() -> None:
    server = TcpTransport.listen("127.0.0.1", 0)
    client = TcpTransport.connect("127.0.0.1", server.port)
    packet = bytes(range(250))
    began = time.monotonic()
    for _ in range(4000):
        client.send(packet)
    assert time.monotonic() - began < 30.0
    data = b""
    for _ in range(3000):
        client.receive()  # goes on with what waits
        data += server.receive()
    assert 250 * 30 <= len(data) < 250 * 4000  # 8 kB wait, however fast they were sent
    whole = len(data) // 250
    assert data[: 250 * whole] == packet * whole
    client.close()
    server.close()


def test_no_packet_waits_for_long_for_a_tcp_peer_that_is_out_of_reach() -> None:
    with (
        closing(TcpTransport.listen("127.0.0.1", 0)) as server,
        socket.socket(socket.AF_INET, socket.SOCK_STREAM) as peer,
    ):
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        peer.connect(("127.0.0.1", server.port))
        server.receive()
        for _ in range(5000):
            server.send(bytes(53))
        came = 0
        peer.settimeout(0.3)
        with suppress(TimeoutError):
            while data := peer.recv(4096):
                came += len(data)
                server.receive()
    assert 0 < came < 20_000  # of 265 kB


@pytest.mark.slow
def test_a_tcp_peer_where_nothing_arrives_any_more_is_called_anew() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        server.setblocking(False)

        def called() -> socket.socket | None:
            client.send(bytes(250))
            client.receive()
            with suppress(BlockingIOError):
                return server.accept()[0]
            return None

        client = TcpTransport.connect("127.0.0.1", server.getsockname()[1])
        with closing(client), until(called) as first, until(called) as second:
            # The first one never reads.
            assert first.getpeername() != second.getpeername()


def test_a_tcp_peer_that_sends_without_end_does_not_hold_up_who_listens() -> None:
    server, sent = TcpTransport.listen("127.0.0.1", 0), 0
    with closing(server), socket.create_connection(("127.0.0.1", server.port)) as peer:
        server.receive()
        peer.settimeout(0.1)
        with suppress(TimeoutError):  # comes when all that waits for us has no more room
            while True:
                sent += peer.send(bytes(1 << 16))
        parts = [server.receive()]
        while parts[-1]:
            parts.append(server.receive())
    assert sent > 1 << 19
    assert max(map(len, parts)) <= 1 << 14
    assert sum(map(len, parts)) == sent


def test_a_refused_connection_says_that_nobody_listens(free_port: Callable[[], int]) -> None:
    port = free_port()
    with pytest.raises(ConnectionFailedError, match=f"nobody listens on port {port} of 127.0.0.1"):
        open_connection(f"tcp:127.0.0.1:{port}")


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_port_in_use_is_named(kind: str, free_port: Callable[[], int]) -> None:
    with closing(open_connection(f"{kind}:127.0.0.1:{(port := free_port())}")):
        pattern = f"{kind}:127.0.0.1:{port}.*in use.*--connect"
        with pytest.raises(ConnectionFailedError, match=pattern):
            open_connection(f"{kind}:127.0.0.1:{port}")


@pytest.mark.parametrize("kind", ["udpout", "tcp"])
def test_a_name_that_is_not_known_is_told(kind: str) -> None:
    with pytest.raises(ConnectionFailedError, match=r"'drone\.invalid' is not known"):
        open_connection(f"{kind}:drone.invalid:14550")


@pytest.mark.parametrize("host", ["drone..local", 64 * "a"])
def test_what_can_be_no_name_is_told(host: str) -> None:
    with pytest.raises(ConnectionFailedError, match=f"{host}' is no name that a computer can have"):
        open_connection(f"udpout:{host}:14550")


def test_an_address_of_another_machine_is_told() -> None:
    with pytest.raises(ConnectionFailedError, match=r"not this machine's address; 0\.0\.0\.0"):
        open_connection("udpin:192.0.2.1:14540")


def test_a_stranger_does_not_draw_the_stream_away_from_the_vehicle() -> None:
    listener = UdpTransport.listen("127.0.0.1", 0)
    vehicle = UdpTransport.connect("127.0.0.1", listener.port)
    strangers = [UdpTransport.connect("127.0.0.1", listener.port) for _ in range(5)]
    for speaker in (vehicle, *strangers):
        speaker.send(b"here")
    assert _receive(listener, 24) == b"here" * 6
    listener.send(b"setpoint")
    assert _receive(vehicle, 8) == b"setpoint"
    for transport in (listener, vehicle, *strangers):
        transport.close()


@contextmanager
def _pty() -> Iterator[tuple[int, str]]:
    theirs, ours = os.openpty()
    name = os.ttyname(ours)
    tty.setraw(theirs)
    os.set_blocking(theirs, False)
    try:
        yield theirs, name
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize(
    "form", ["{}:57600", "{},57600", "serial:{}:921600", "serial:{}", "{}"], ids=str
)
def test_a_serial_port_carries_every_byte_both_ways(form: str) -> None:
    every = bytes(range(256))  # also those that a terminal would take for commands
    with _pty() as (theirs, name), closing(open_connection(form.format(name))) as port:
        port.send(every)
        assert _read(theirs, 256) == every
        os.write(theirs, every)
        assert _receive(port, 256) == every
        assert port.receive() == b""


@pytest.mark.parametrize(
    ("part", "flag"),
    [
        (0, "IGNCR"),
        (0, "INLCR"),
        (0, "PARMRK"),
        (0, "IXOFF"),
        (1, "OPOST"),
        (2, "CSTOPB"),
        (2, "CRTSCTS"),
        (3, "ECHO"),
    ],
)
def test_what_another_program_left_of_a_serial_port_does_not_count(part: int, flag: str) -> None:
    every = bytes(range(256))
    with _pty() as (theirs, name):
        line = os.open(name, os.O_RDWR | os.O_NOCTTY)
        left = termios.tcgetattr(line)
        left[part] |= getattr(termios, flag)
        termios.tcsetattr(line, termios.TCSANOW, left)
        with closing(open_connection(name)) as port:
            os.write(theirs, every)
            assert _receive(port, 256) == every
            assert not termios.tcgetattr(line)[part] & getattr(termios, flag)
        os.close(line)


def _read(file: int, wanted: int, patience_s: float = 2.0) -> bytes:
    data = b""
    for _ in range(round(1000 * patience_s)):
        try:
            data += os.read(file, 4096)
        except BlockingIOError:
            time.sleep(0.001)
        if len(data) >= wanted:
            break
    return data


def test_one_thread_sends_while_another_one_polls() -> None:
    """The ground station's side sends by itself; the serial port knows nothing of threads."""
    ours, theirs = os.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    failures: list[BufferError] = []
    with closing(SerialTransport(os.ttyname(theirs), 115200)) as transport:
        channel = PacketChannel(transport)
        stop = threading.Event()

        def send() -> None:
            while not stop.is_set():
                try:
                    channel.send(bytes(260))
                except BufferError as error:
                    failures.append(error)

        sender = threading.Thread(target=send)
        sender.start()
        try:
            for _ in range(5000):
                with suppress(BlockingIOError):
                    os.read(ours, 65536)
                channel.receive(0.0)
        finally:
            stop.set()
            sender.join()
    os.close(ours)
    os.close(theirs)
    assert not failures


def test_a_line_that_is_too_slow_loses_whole_packets_and_blocks_nobody() -> None:
    packet = bytes(range(1, 101))
    with _pty() as (theirs, name), closing(open_connection(name)) as port:
        for _ in range(5000):
            port.send(packet)
        data = b""
        while chunk := _read(theirs, 1, patience_s=0.05):
            data += chunk
            port.receive()  # goes on with what waits
        whole = len(data) // 100
        assert whole > 10
        assert data[: 100 * whole] == packet * whole


def test_no_packet_waits_for_long_before_a_slow_line() -> None:
    """Also not in the system: a setpoint of a second ago would be flown after a takeover."""
    line, reader = socket.socketpair()
    line.setblocking(False)
    clock, packet = SimulatedClock(), bytes(50)
    with closing(_StreamTransport(lambda: -1, line.detach(), 1.0, clock, 5000.0)) as stream, reader:
        for _ in range(100):
            stream.send(packet)
        assert len(reader.recv(65536, socket.MSG_PEEK)) == pytest.approx(500, abs=50)
        clock.sleep_until(0.05)
        for _ in range(100):
            stream.send(packet)
        assert len(reader.recv(65536)) == pytest.approx(750, abs=50)
        for _ in range(100):  # all has left, sooner than its rate said, as over USB
            stream.send(packet)
        assert len(reader.recv(65536)) == pytest.approx(500, abs=50)


def test_a_port_that_was_pulled_out_is_looked_for_again(tmp_path: Path) -> None:
    clock = SimulatedClock()
    plug = tmp_path / "ttyACM0"
    with _pty() as (theirs, name), _pty() as (other, new_name):
        plug.symlink_to(name)
        port = SerialTransport(str(plug), 57600, clock)
        port.send(b"1")
        assert _read(theirs, 1) == b"1"
        port._drop()
        plug.unlink()
        port.send(b"2")
        clock.sleep_until(1.5)
        assert port.receive() == b""
        plug.symlink_to(new_name)
        clock.sleep_until(3.0)
        port.receive()
        port.send(b"3")
        assert _read(other, 1) == b"3"
        port.close()


@pytest.mark.parametrize("baud", [57601, 0])
def test_a_baud_rate_that_there_is_not_is_answered_with_those_that_there_are(baud: int) -> None:
    with (
        _pty() as (_, name),
        pytest.raises(ConnectionFailedError, match=rf"{baud} is no baud rate.*57600.*921600"),
    ):
        open_connection(f"{name}:{baud}")


def test_a_device_that_is_not_there_or_no_serial_port_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConnectionFailedError, match=r"/dev/ttyACM77: No such file.*plugged in"):
        open_connection("/dev/ttyACM77:57600")
    file = tmp_path / "ttyACM0"
    file.write_bytes(b"")
    with pytest.raises(ConnectionFailedError, match="it is no serial port"):
        open_connection(f"{file}:57600")


Refuse = Callable[[int], None]


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Refuse:
    """Return what makes every serial port fail with an error number."""

    def refuse_with(number: int) -> None:
        def fail(device: str, _baud: int) -> Transport:
            raise OSError(number, os.strerror(number), device)

        monkeypatch.setattr(connections, "SerialTransport", fail)

    return refuse_with


def test_a_missing_permission_names_the_group_to_join(refuse: Refuse) -> None:
    refuse(errno.EACCES)
    pattern = r"/dev/ttyACM0: Permission denied.*join the group dialout: sudo usermod -aG dialout"
    with pytest.raises(ConnectionFailedError, match=pattern):
        open_connection("/dev/ttyACM0:57600")


def test_a_port_that_another_program_uses_is_told(refuse: Refuse) -> None:
    refuse(errno.EBUSY)
    with pytest.raises(ConnectionFailedError, match=r"another program uses it.*ModemManager"):
        open_connection("/dev/ttyACM0")
