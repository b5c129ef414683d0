"""Whatever bytes come over the link: nothing is raised, and nothing untrue is believed."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.faults.fuzz import LinkFuzzer
from follower.links.autopilot_clock import AutopilotClock
from follower.links.channel import PacketChannel
from follower.links.packets import PacketReader
from follower.links.parameter_reader import ParameterReader
from follower.links.signing import Signer
from follower.links.signing_key import SigningKey
from follower.links.timesync import TimeSync
from follower.links.vehicle_finder import VehicleFinder
from follower_control.transport import MemoryTransport

EPOCH_NS = 1_790_000_000 * 10**9
BEAT = bytes(
    mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3).pack(mavlink.MAVLink(None, 1, 1))
)
INT64 = st.integers(-(2**63), 2**63 - 1)
SECONDS = st.floats(0, 1e6)
PIECES = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.just(BEAT),
        st.builds(lambda at: BEAT[:at], st.integers(0, len(BEAT))),
        st.builds(lambda data: b"\xfd" + data, st.binary(max_size=30)),
        st.builds(lambda data: b"\xfe" + data, st.binary(max_size=30)),
    ),
    max_size=12,
)


@given(PIECES, st.data())
def test_the_same_packets_are_found_however_the_stream_is_cut(
    pieces: list[bytes], draw: st.DataObject
) -> None:
    stream = b"".join(pieces)
    cuts = sorted(draw.draw(st.lists(st.integers(0, len(stream)), max_size=5)))
    whole, cut = PacketReader(), PacketReader()
    expected = [packet.data for packet in whole.feed(stream)]
    found = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += [packet.data for packet in cut.feed(stream[start:end])]
    assert found == expected
    assert sum(map(len, found)) + cut.skipped_bytes <= len(stream)


def test_garbage_that_looks_like_an_unknown_packet_hides_nothing_where_the_stream_is_cut() -> None:
    garbage = b"\xfe\x63\x00\x00\x00\x96"
    whole, cut = PacketReader(), PacketReader()
    stream = garbage + 10 * BEAT
    end_of_what_it_claims = 6 + 0x63 + 2
    found = cut.feed(stream[:end_of_what_it_claims]) + cut.feed(stream[end_of_what_it_claims:])
    assert found == whole.feed(stream)
    assert len(found) == 10


@given(PIECES)
def test_a_signed_channel_believes_nothing_unsigned(pieces: list[bytes]) -> None:
    ours, theirs = MemoryTransport.pair()
    channel = PacketChannel(ours, Signer(SigningKey(bytes(range(32))), EPOCH_NS))
    for number, piece in enumerate(pieces):
        theirs.send(piece)
        assert channel.receive(0.02 * number) == []


@given(st.integers(0, len(BEAT) + 12), st.integers(1, 255))
def test_a_signed_packet_with_any_byte_changed_is_not_believed(at: int, change: int) -> None:
    signed = bytearray(Signer(SigningKey(bytes(range(32))), EPOCH_NS).sign(BEAT, 1.0))
    signed[at] ^= change
    ours, theirs = MemoryTransport.pair()
    channel = PacketChannel(ours, Signer(SigningKey(bytes(range(32))), EPOCH_NS))
    theirs.send(bytes(signed))
    assert channel.receive(1.0) == []


@given(st.lists(st.tuples(SECONDS, INT64, st.one_of(st.none(), INT64)), max_size=30))
def test_no_answer_of_timesync_breaks_the_clock(
    answers: list[tuple[float, int, int | None]],
) -> None:
    clock = AutopilotClock()
    timesync = TimeSync(clock, 5.0)
    for now_s, tc1, ts1 in sorted(answers, key=lambda answer: answer[0]):
        asked = timesync.question(now_s)
        for stamp in (ts1, asked):
            if stamp is not None:
                timesync.answer(tc1, stamp, now_s)
        mapped_s = clock.to_system((tc1 % 2**32) / 1000.0, now_s)
        assert mapped_s <= now_s
        assert not math.isnan(mapped_s)
        assert clock.error_s is None or clock.error_s >= 0


@given(
    st.lists(
        st.tuples(
            st.integers(0, 255), st.integers(0, 255), st.integers(0, 255), st.integers(0, 255)
        ),
        max_size=40,
    ),
    st.one_of(st.none(), st.integers(1, 255)),
)
def test_only_an_autopilots_heartbeat_makes_a_vehicle_and_several_make_none(
    beats: list[tuple[int, int, int, int]], wanted: int | None
) -> None:
    finder = VehicleFinder(wanted, 0.0)
    for number, beat in enumerate(beats):
        finder.hear(*beat, 0.1 * number)
    found = finder.found(0.1 * len(beats))
    finder.problem(0.1 * len(beats))
    true = {system for system, component, _, kind in beats if component == 1 and kind in (3, 12)}
    assert found is None or (found.system in true and found.system != 0)
    assert found is None or wanted in (None, found.system)
    assert len(finder.vehicles(0.1 * len(beats))) <= 1 or wanted is not None or found is None


@given(
    st.booleans(),
    st.lists(st.tuples(st.text(max_size=16), st.floats(width=32), st.integers(0, 255))),
)
def test_parameters_that_are_no_numbers_are_not_kept(
    bytewise: bool, values: list[tuple[str, float, int]]
) -> None:
    reader = ParameterReader(bytewise)
    reader.want([name for name, _, _ in values] + ["GUID_TIMEOUT"])
    for name, carried, kind in values:
        reader.take(name, carried, kind)
    reader.due(0.0)
    assert all(isinstance(value, float | int) for value in reader.values.values())
    assert "GUID_TIMEOUT" not in reader.values or any(n == "GUID_TIMEOUT" for n, _, _ in values)


@settings(max_examples=40)
@given(st.integers(0, 2**32), st.booleans())
def test_a_link_survives_true_spoilt_and_invented_packets(seed: int, signed: bool) -> None:
    fuzzer = LinkFuzzer(seed, signed)
    for _ in range(60):
        fuzzer.step()
    assert fuzzer.fed_bytes > 10_000


@pytest.mark.parametrize("signed", [False, True])
def test_the_fuzzer_feeds_packets_that_count(signed: bool) -> None:
    fuzzer = LinkFuzzer(1, signed)
    for _ in range(60):
        fuzzer.step()
    status = fuzzer._link.status(fuzzer._now_s)
    if signed:
        assert status.refused["not signed"] > 50
        assert status.refused["wrong signature"] > 5
        assert not fuzzer._link.connected
    else:
        assert status.received > 50
        assert fuzzer._link.connected
