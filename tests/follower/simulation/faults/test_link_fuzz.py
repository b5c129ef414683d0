"""Whatever bytes come over the link: nothing is raised, and nothing untrue is believed."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.links.clock_sync import AutopilotClock, TimeSync
from follower.links.packet_channel import PacketChannel
from follower.links.packet_parser import PacketReader, checksum
from follower.links.pymavlink_link import MavlinkLink
from follower.links.request_scheduler import ParameterReader
from follower.links.signing import Signer, SigningKey
from follower.links.vehicle_finder import VehicleFinder, vehicle_of
from follower.settings.link import LinkSettings
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.setpoint import HOLD
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState

EPOCH_NS = 1_790_000_000 * 10**9
BEAT = bytes(
    mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3).pack(mavlink.MAVLink(None, 1, 1))
)
CORPUS_S = 1.2
MESSAGES = tuple(mavlink.mavlink_map)
COMMON = tuple(
    number
    for number, message in mavlink.mavlink_map.items()
    if message.msgname
    in {
        *("HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "TIMESYNC"),
        *("EXTENDED_SYS_STATE", "COMMAND_ACK", "COMMAND_LONG", "STATUSTEXT", "PARAM_VALUE"),
        *("SYS_STATUS", "RC_CHANNELS", "GPS_RAW_INT", "ESTIMATOR_STATUS", "AUTOPILOT_VERSION"),
        "BATTERY_STATUS",
    }
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


class FuzzError(AssertionError):
    """The link believed something that it must not believe."""


class LinkFuzzer:
    """Feeds one link after another with true packets, spoilt ones, invented ones, and noise.

    Args:
        seed: of everything random.
        signed: the link wants signatures, and gets none that are right.

    Attributes:
        fed_bytes: so many went in.
        polls: so often the link was asked.
    """

    def __init__(self, seed: int, signed: bool = False) -> None:
        self._rng = np.random.default_rng(seed)
        self._signed = signed
        self._corpus = corpus()
        self._wrong_signer = Signer(SigningKey(bytes(range(50, 82))), EPOCH_NS)
        self.fed_bytes = 0
        self.polls = 0
        self._makers: tuple[Callable[[], bytes], ...] = (
            self._true,
            self._spoilt,
            self._invented,
            self._invented,
            self._noise,
        )
        self._begin()

    def step(self) -> None:
        """Feed some bytes, poll, and look at what came of it.

        Raises:
            FuzzError: something is believed that must not be.
        """
        if self.polls % 500 == 0:
            self._begin()
        data = b"".join(self._draw()() for _ in range(int(self._rng.integers(1, 12))))
        cut = int(self._rng.integers(0, len(data) + 1))
        for piece in (data[:cut], data[cut:]):
            self._peer.send(piece)
            self.now_s += float(self._rng.choice([0.0, 0.02, 0.5, 5.0], p=[0.1, 0.8, 0.08, 0.02]))
            self._poll()
        self.fed_bytes += len(data)

    def _begin(self) -> None:
        ours, self._peer = MemoryTransport.pair()
        key = Signer(SigningKey(bytes(range(32))), EPOCH_NS) if self._signed else None
        wanted = 1 if self._rng.random() < 0.7 else None
        self.link = MavlinkLink(ours, LinkSettings(vehicle_id=wanted, listen_s=0.0), key)
        self.link.watch_health()
        self.now_s = float(self._rng.uniform(0.0, 1e5))

    def _poll(self) -> None:
        link, now_s = self.link, self.now_s
        self.polls += 1
        link.poll(now_s)
        link.send(HOLD)
        link.take_notes()
        for command in link.take_commands():
            link.answer(command, accepted=True)
        link.status(now_s).line()
        self._peer.receive()
        self._check()

    def _check(self) -> None:
        state = self.link.state
        numbers: tuple[float, ...] = (*self._ages(),)
        if state.attitude is not None:
            numbers += (*state.attitude.numbers, state.attitude.time_s)
        if state.position is not None:
            p = state.position
            numbers += (p.north_m, p.east_m, p.down_m, p.north_m_s, p.east_m_s, p.down_m_s)
        if not all(map(math.isfinite, numbers)):
            raise FuzzError(f"what is not finite came through: {state}")
        if any(age < 0 for age in self._ages()):
            raise FuzzError(f"telemetry from the future: {state} at {self.now_s}")
        if self._signed and self.link.connected:
            raise FuzzError("an unsigned word was believed on a signed link")

    def _ages(self) -> list[float]:
        state, now_s = self.link.state, self.now_s
        ages = [state.attitude_age_s(now_s), state.position_age_s(now_s)]
        return [age for age in (*ages, state.heartbeat_age_s(now_s)) if age != math.inf]

    def _draw(self) -> Callable[[], bytes]:
        return self._makers[int(self._rng.integers(len(self._makers)))]

    def _true(self) -> bytes:
        return self._corpus[int(self._rng.integers(len(self._corpus)))]

    def _spoilt(self) -> bytes:
        """Return a true packet that was changed, cut, doubled or wrongly signed."""
        data = bytearray(self._true())
        how = int(self._rng.integers(4))
        if how == 0:
            data[int(self._rng.integers(len(data)))] = int(self._rng.integers(256))
        elif how == 1:
            del data[int(self._rng.integers(len(data))) :]
        elif how == 2:
            data = data * 2
        else:
            return self._wrong_signer.sign(bytes(data), self.now_s)
        return bytes(data)

    def _invented(self) -> bytes:
        """Return a packet of any message with any payload and a right checksum."""
        known = COMMON if self._rng.random() < 0.7 else MESSAGES
        number = int(known[int(self._rng.integers(len(known)))])
        payload = self._rng.bytes(int(self._rng.integers(0, 256)))
        system, component = ((1, 1), (1, 1), (1, 191), (255, 190), (2, 1))[self._rng.integers(5)]
        head = bytes((0xFD, len(payload), 0, 0, int(self._rng.integers(256)), system, component))
        body = head + number.to_bytes(3, "little") + payload
        return body + checksum(body, int(mavlink.mavlink_map[number].crc_extra))

    def _noise(self) -> bytes:
        return self._rng.bytes(int(self._rng.integers(0, 300)))


@cache
def corpus() -> list[bytes]:
    """Return what true autopilots of both kinds say in a second, packet by packet."""
    packets: list[bytes] = []
    for flavour in ("px4", "ardupilot"):
        ours, theirs = MemoryTransport.pair()
        autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, -10.0)))
        for step in range(int(CORPUS_S / 0.005)):
            autopilot.step(0.005 * step)
            packets += [packet.data for packet in PacketReader().feed(ours.receive())]
    return packets


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
        if (vehicle := vehicle_of(*beat)) is not None:
            finder.take(vehicle, 0.1 * number)
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


@pytest.mark.slow
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
    status = fuzzer.link.status(fuzzer.now_s)
    if signed:
        assert status.refused["not signed"] > 50
        assert status.refused["wrong signature"] > 5
        assert not fuzzer.link.connected
    else:
        assert status.received > 50
        assert fuzzer.link.connected
