"""Packets are found in anything, and nothing that is none is taken for one."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.links.packet_channel import SequenceCounter
from follower.links.packet_parser import (
    PacketReader,
    Unpacker,
    checksum,
    crc_extra_of,
    message_id_of,
)
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.link import LinkSettings
from follower_control.common.transport import MemoryTransport


def _codec(system: int = 7, component: int = 1) -> Any:
    return mavlink.MAVLink(None, system, component)


def _beat(system: int = 7, component: int = 1, kind: int = 2, autopilot: int = 12) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 129, 6 << 16, 4, 3)
    return bytes(message.pack(_codec(system, component)))


def _attitude(roll: float, system: int = 7, component: int = 1) -> bytes:
    message = mavlink.MAVLink_attitude_message(1000, roll, 0, 0, 0, 0, 0)
    return bytes(message.pack(_codec(system, component)))


@given(st.binary(max_size=60).filter(lambda data: not {0xFD, 0xFE} & set(data)), st.data())
def test_a_packet_is_found_behind_garbage_whatever_pieces_it_comes_in(
    garbage: bytes, draw: st.DataObject
) -> None:
    stream = garbage + _beat() + garbage + _attitude(0.1)
    cut = draw.draw(st.integers(0, len(stream)))
    reader = PacketReader()
    packets = reader.feed(stream[:cut]) + reader.feed(stream[cut:])
    assert [packet.data for packet in packets] == [_beat(), _attitude(0.1)]
    assert reader.skipped_bytes == 2 * len(garbage)


def test_a_truncated_packet_does_not_hide_the_next_ones() -> None:
    reader = PacketReader()
    packets = reader.feed(_attitude(0.1)[:15] + _beat() + _attitude(0.2) + _beat())
    assert [packet.message_id for packet in packets] == [0, 30, 0]


def test_headers_that_promise_too_much_do_not_hide_what_follows() -> None:
    reader = PacketReader()
    packets = reader.feed(b"\xfd" * 30 + b"\xfd\xff\x00\x00\x00\x07\x01\x1e\x00\x00" + 9 * _beat())
    packets += reader.feed(20 * _beat())
    assert len(packets) == 29


@given(st.integers(0, 20 * 8 - 1))
def test_a_flipped_bit_makes_a_packet_none(bit: int) -> None:
    data = bytearray(_beat())
    data[bit // 8] ^= 1 << bit % 8
    found = PacketReader().feed(bytes(data) + b"\x00" * 300)
    assert [packet.data for packet in found] != [bytes(data)]


UNKNOWN = b"\xfd\x09\x00\x00\x2a\x07\x01\x9a\x2b\x00" + b"\xfd" * 9 + b"ab"


def test_another_dialects_message_is_a_packet_of_which_the_head_alone_is_known() -> None:
    beat, unknown = PacketReader().feed(_beat() + UNKNOWN + _beat())[:2]
    assert (beat.is_known, unknown.is_known) == (True, False)
    assert (unknown.system, unknown.component, unknown.sequence) == (7, 1, 42)
    assert unknown.data == UNKNOWN


def test_from_nobody_whose_packets_were_right_it_is_garbage() -> None:
    packets = PacketReader().feed(UNKNOWN + _beat() + UNKNOWN)
    assert [packet.message_id for packet in packets] == [0]


def test_a_strangers_unknown_message_hides_nothing() -> None:
    """Garbage can look like one, and end just where a true packet begins."""
    reader = PacketReader()
    reader.feed(_beat())
    claims = 2 * len(_beat()) - 8
    garbage = bytes((0xFE, claims, 0, 66, 9, 150))
    assert len(reader.feed(garbage + 4 * _beat())) == 4


def test_a_header_that_is_never_completed_holds_nothing_back_for_long() -> None:
    reader = PacketReader()
    header = b"\xfd\xff\x00\x00\x00\x07\x01\x1e\x00\x00"
    assert reader.feed(header, 1.0) == []
    assert reader.feed(_beat(), 1.02) == []
    assert [packet.data for packet in reader.feed(b"", 1.06)] == [_beat()]


def test_mavlink_1_is_understood() -> None:
    message = mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3)
    (packet,) = PacketReader().feed(bytes(message.pack(_codec(9), force_mavlink1=True)))
    assert (packet.system, packet.component, packet.message_id, packet.signed) == (9, 1, 0, False)


def test_lost_packets_are_counted_and_late_or_doubled_ones_are_not() -> None:
    counter = SequenceCounter()
    for sequence in (250, 251, 251, 255, 0, 2, 1, 3):
        counter.count(sequence)
    assert (counter.came, counter.lost) == (7, 3)  # 252 to 254; number 1 was late only


def test_the_share_of_lost_packets_is_the_vehicles_however_much_others_send() -> None:
    ours, message = _codec(7), mavlink.MAVLink_attitude_message(1000, 0, 0, 0, 0, 0, 0)
    packets = [_beat()]
    for ours.seq in range(0, 200, 2):  # each second one is lost
        packets += [bytes(message.pack(ours)), _attitude(0.0, system=8), _attitude(0.0, system=9)]
    status = _link(b"".join(packets)).status(1.0)
    assert status.received == 301
    assert status.lost_share == pytest.approx(0.5, abs=0.01)


def _link(data: bytes, vehicle_id: int | None = 7) -> MavlinkLink:
    ours, theirs = MemoryTransport.pair()
    link = MavlinkLink(ours, LinkSettings(vehicle_id=vehicle_id, listen_s=0.0))
    theirs.send(data)
    link.poll(1.0)
    return link


@given(st.binary(max_size=400))
def test_no_bytes_raise_or_change_the_state(data: bytes) -> None:
    ours, theirs = MemoryTransport.pair()
    link = MavlinkLink(ours, LinkSettings(vehicle_id=7))
    theirs.send(_beat() + _attitude(0.25))
    link.poll(1.0)
    before = link.state
    theirs.send(data)
    link.poll(1.1)
    assert link.state == before
    theirs.send(20 * _beat())
    link.poll(2.0)
    assert link.state.heartbeat_s == 2.0


@given(
    st.sampled_from(sorted(mavlink.mavlink_map)),
    st.binary(max_size=255),
    st.integers(0, 255),
    st.integers(0, 255),
)
def test_a_whole_packet_of_any_content_from_others_changes_nothing(
    message_id: int, payload: bytes, system: int, component: int
) -> None:
    head = bytes((0xFD, len(payload), 0, 0, 0, system, component))
    body = head + message_id.to_bytes(3, "little") + payload
    packet = body + checksum(body, mavlink.mavlink_map[message_id].crc_extra)
    link = _link(_beat() + _attitude(0.25))
    before, height = link.state, link.altitude_msl_m
    link._channel._transport._inbox.append(packet)  # type: ignore[attr-defined]
    link.poll(1.01)  # never raises
    if (system, component) != (7, 1):
        assert (link.state, link.altitude_msl_m) == (before, height)
        assert link.status(1.01).vehicle_id == 7


def test_messages_of_the_autopilots_own_dialect_do_not_count_as_lost() -> None:
    ours, theirs = MemoryTransport.pair()
    link = MavlinkLink(ours, LinkSettings(vehicle_id=7))
    for number in range(100):
        theirs.send(_numbered(UNKNOWN, 2 * number) + _numbered(_beat(), 2 * number + 1))
        link.poll(0.1 * number)
    status = link.status(10.0)
    assert (status.lost, status.received) == (0, 199)  # the first came before its sender was known
    theirs.send(_numbered(_beat(), 205))
    link.poll(10.0)
    assert link.status(10.0).lost == 5


def _numbered(packet: bytes, number: int) -> bytes:
    """Return the packet with another sequence number."""
    data = bytearray(packet)
    data[4] = number % 256
    crc_extra = crc_extra_of(message_id_of(packet))
    if crc_extra is not None:
        data[-2:] = checksum(bytes(data[:-2]), crc_extra)
    return bytes(data)


NUMBERS = st.floats(-100, 100, width=32)


@given(st.tuples(*[NUMBERS] * 6), st.booleans())
def test_an_attitude_is_unpacked_as_pymavlink_does(
    numbers: tuple[float, ...], first_protocol: bool
) -> None:
    message = mavlink.MAVLink_attitude_message(12345, *numbers)
    data = message.pack(mavlink.MAVLink(None, 3, 1), force_mavlink1=first_protocol)
    (packet,) = PacketReader().feed(bytes(data))
    expected = mavlink.MAVLink(None).decode(bytearray(data))
    assert Unpacker().message(packet).to_dict() == expected.to_dict()


def test_a_text_is_unpacked_too() -> None:
    data = mavlink.MAVLink_statustext_message(6, b"Ready").pack(mavlink.MAVLink(None, 3, 1))
    (packet,) = PacketReader().feed(bytes(data))
    assert Unpacker().message(packet).text == "Ready"
