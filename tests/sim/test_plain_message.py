"""The short way from bytes to a message gives what pymavlink's own gives, or nothing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower_control.transport import MemoryTransport
from follower_sim.faults import Faults
from follower_sim.mavlink_endpoint import MavlinkEndpoint
from follower_sim.plain_message import FRAME_BYTES, packed, plain_message

CODEC = mavlink.MAVLink(None, 7, 191)
NUMBERS = st.floats(-100, 100, width=32)


def command(*params: float) -> bytes:
    message = mavlink.MAVLink_command_long_message(1, 1, 511, 0, *params)
    return bytes(message.pack(CODEC))


@given(st.tuples(*[NUMBERS] * 7), st.binary(max_size=30))
def test_it_reads_what_pymavlink_reads(params: tuple[float, ...], after: bytes) -> None:
    data = command(*params)
    message = plain_message(data + after)
    expected = mavlink.MAVLink(None).decode(bytearray(data))
    assert message.to_dict() == expected.to_dict()
    assert message.get_header().mlen + FRAME_BYTES == len(data)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 191)


@given(st.tuples(*[NUMBERS] * 6), st.integers(0, 255), st.integers(0, 2))
def test_it_packs_what_pymavlink_packs(
    numbers: tuple[float, ...], sequence: int, kind: int
) -> None:
    codec = mavlink.MAVLink(None, 7, 191)
    codec.seq = sequence
    message = (
        mavlink.MAVLink_attitude_message(12345, *numbers),
        mavlink.MAVLink_timesync_message(0, 0),
        mavlink.MAVLink_statustext_message(6, b"hello"),
    )[kind]
    assert packed(message, codec) == bytes(message.pack(codec))


@pytest.mark.parametrize("at", [0, 2, 8, 12, -1])
def test_what_is_broken_is_nothing(at: int) -> None:
    data = bytearray(command(*(1.0,) * 7))
    data[at] ^= 0x55
    assert plain_message(bytes(data)) is None
    assert plain_message(bytes(data[:-1])) is None
    assert plain_message(b"") is None


def test_what_comes_in_pieces_and_amid_garbage_is_heard_in_order() -> None:
    ours, theirs = MemoryTransport.pair()
    endpoint = MavlinkEndpoint(ours, 1, 1, Faults(), rng=None)  # type: ignore[arg-type]
    text = bytes(mavlink.MAVLink_statustext_message(6, b"hello").pack(CODEC))
    packets = [command(*(float(n),) * 7) for n in range(1, 5)]
    heard = []
    first, rest = packets[2][:9], packets[2][9:]
    for data in (packets[0] + text + packets[1] + first, rest + b"\x00\x01" + packets[3]):
        theirs.send(data)
        heard += [
            m.param1 if m.get_type() == "COMMAND_LONG" else m.text for m in endpoint.receive()
        ]
    assert heard == [1.0, "hello", 2.0, 3.0, 4.0]
