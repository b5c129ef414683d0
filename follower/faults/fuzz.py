"""Bytes that may be anything, fed to a link; what it makes of them is checked."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower.links.link_settings import LinkSettings
from follower.links.mavlink import MavlinkLink
from follower.links.packets import PacketReader, checksum
from follower.links.signing import Signer
from follower.links.signing_key import SigningKey
from follower_control.setpoint import HOLD
from follower_control.transport import MemoryTransport
from follower_sim.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState

_EPOCH_NS = 1_790_000_000 * 10**9
_CORPUS_S = 1.2
_MESSAGES = tuple(mavlink.mavlink_map)
_COMMON = tuple(
    number
    for number, message in mavlink.mavlink_map.items()
    if message.msgname
    in (
        "HEARTBEAT",
        "ATTITUDE",
        "LOCAL_POSITION_NED",
        "GLOBAL_POSITION_INT",
        "EXTENDED_SYS_STATE",
        "TIMESYNC",
        "COMMAND_ACK",
        "COMMAND_LONG",
        "STATUSTEXT",
        "PARAM_VALUE",
        "SYS_STATUS",
        "RC_CHANNELS",
        "GPS_RAW_INT",
        "ESTIMATOR_STATUS",
        "AUTOPILOT_VERSION",
        "BATTERY_STATUS",
    )
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
        self._corpus = _corpus()
        self._liar = Signer(SigningKey(bytes(range(50, 82))), _EPOCH_NS)
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
            self._now_s += float(self._rng.choice([0.0, 0.02, 0.5, 5.0], p=[0.1, 0.8, 0.08, 0.02]))
            self._poll()
        self.fed_bytes += len(data)

    def _begin(self) -> None:
        ours, self._peer = MemoryTransport.pair()
        key = Signer(SigningKey(bytes(range(32))), _EPOCH_NS) if self._signed else None
        wanted = 1 if self._rng.random() < 0.7 else None
        self._link = MavlinkLink(ours, LinkSettings(vehicle_id=wanted, listen_s=0.0), key)
        self._link.watch_health()
        self._now_s = float(self._rng.uniform(0.0, 1e5))

    def _poll(self) -> None:
        link, now_s = self._link, self._now_s
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
        state = self._link.state
        numbers: tuple[float, ...] = (*self._ages(),)
        if state.attitude is not None:
            numbers += (*state.attitude.numbers, state.attitude.time_s)
        if state.position is not None:
            p = state.position
            numbers += (p.north_m, p.east_m, p.down_m, p.north_m_s, p.east_m_s, p.down_m_s)
        if not all(map(math.isfinite, numbers)):
            raise FuzzError(f"what is not finite came through: {state}")
        if any(age < 0 for age in self._ages()):
            raise FuzzError(f"telemetry from the future: {state} at {self._now_s}")
        if self._signed and self._link.connected:
            raise FuzzError("an unsigned word was believed on a signed link")

    def _ages(self) -> list[float]:
        state, now_s = self._link.state, self._now_s
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
            return self._liar.sign(bytes(data), self._now_s)
        return bytes(data)

    def _invented(self) -> bytes:
        """Return a packet of any message with any payload and a right checksum."""
        known = _COMMON if self._rng.random() < 0.7 else _MESSAGES
        number = int(known[int(self._rng.integers(len(known)))])
        payload = self._rng.bytes(int(self._rng.integers(0, 256)))
        system, component = ((1, 1), (1, 1), (1, 191), (255, 190), (2, 1))[self._rng.integers(5)]
        head = bytes((0xFD, len(payload), 0, 0, int(self._rng.integers(256)), system, component))
        body = head + number.to_bytes(3, "little") + payload
        return body + checksum(body, int(mavlink.mavlink_map[number].crc_extra))

    def _noise(self) -> bytes:
        return self._rng.bytes(int(self._rng.integers(0, 300)))


@cache
def _corpus() -> list[bytes]:
    """Return what true autopilots of both kinds say in a second, packet by packet."""
    packets: list[bytes] = []
    for flavour in ("px4", "ardupilot"):
        ours, theirs = MemoryTransport.pair()
        autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, -10.0)))
        for step in range(int(_CORPUS_S / 0.005)):
            autopilot.step(0.005 * step)
            packets += [packet.data for packet in PacketReader().feed(ours.receive())]
    return packets
