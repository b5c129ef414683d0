"""The UDP transport under a flood."""

import threading
from contextlib import closing

from follower_control.common.transport import UdpTransport


def test_a_flood_does_not_hold_up_who_listens() -> None:
    ours = UdpTransport.listen("127.0.0.1", 0)
    flood = UdpTransport.connect("127.0.0.1", ours.port)
    stop = threading.Event()

    def pour() -> None:
        while not stop.is_set():
            flood.send(bytes(9))

    pourers = [threading.Thread(target=pour) for _ in range(2)]
    for pourer in pourers:
        pourer.start()
    try:
        # It comes back at all, although there is always more.
        parts = [ours.receive() for _ in range(20)]
    finally:
        stop.set()
        for pourer in pourers:
            pourer.join()
        ours.close()
        flood.close()
    assert max(map(len, parts)) <= 256 * 9


def test_large_datagrams_do_not_hold_up_who_looks_for_packets_in_them() -> None:
    with (
        closing(UdpTransport.listen("127.0.0.1", 0)) as ours,
        closing(UdpTransport.connect("127.0.0.1", ours.port)) as flood,
    ):
        for _ in range(40):
            flood.send(b"\xfe" * 60_000)
        parts = [ours.receive() for _ in range(5)]
    assert 0 < max(map(len, parts)) < 26_000


def test_what_was_left_comes_with_the_next_call_in_its_order() -> None:
    ours = UdpTransport.listen("127.0.0.1", 0)
    peer = UdpTransport.connect("127.0.0.1", ours.port)
    for number in range(300):
        peer.send(number.to_bytes(2, "big"))
    first, second, third = ours.receive(), ours.receive(), ours.receive()
    ours.close()
    peer.close()
    assert (len(first), len(second), third) == (2 * 256, 2 * 44, b"")
    assert first + second == b"".join(number.to_bytes(2, "big") for number in range(300))


def test_a_pair_takes_the_port_that_is_preferred_or_else_any_free_one(free_port):
    port = free_port()
    first, second = UdpTransport.pair(port), UdpTransport.pair(port)
    with closing(first[0]), closing(first[1]), closing(second[0]), closing(second[1]):
        assert first[0].port == port
        assert second[0].port not in (0, port)
        for number, (listener, speaker) in enumerate((first, second)):
            speaker.send(bytes([number]))
            assert listener.receive() == bytes([number])
            listener.send(b"answer")
            assert speaker.receive() == b"answer"
