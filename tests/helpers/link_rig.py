"""A link, a simulated autopilot and what may come between them."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.links.link import Link
from follower.links.open import open_link
from follower.links.packet_parser import PacketReader
from follower.links.signing import Signer, SigningKey
from follower.settings.link import LINK_KINDS, LinkKind, LinkSettings
from follower_control.common.transport import (
    MemoryTransport,
    Transport,
    UdpTransport,
    WrappedTransport,
)
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_sim.autopilot.autopilot import SimAutopilot, run_autopilot
from follower_sim.kinematics import BodyState
from follower_sim.vehicle.vehicle import STEP_S
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock

LateS = Callable[[], float]
EPOCH_NS = 1_790_000_000 * 10**9
SECRET = bytes(range(32))
SETPOINT = mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
_PATIENCE_S = 20.0

_BOTH = ("px4", "ardupilot")
EACH = pytest.mark.parametrize(
    ("kind", "flavour"), [(kind, flavour) for kind in LINK_KINDS for flavour in _BOTH]
)
MAVSDK_ONCE = pytest.mark.parametrize(
    ("kind", "flavour"),
    [(k, flavour) for k in LINK_KINDS for flavour in _BOTH if (k, flavour) != ("mavsdk", "px4")],
)
"""For what MAVSDK does alike with both autopilots."""


class LossyTransport(WrappedTransport):
    """Loses, doubles and reorders packets in both directions, and notes all that is sent."""

    def __init__(self, inner: Transport, clock: Clock, trouble: float = 0.0) -> None:
        super().__init__(inner)
        self._clock = clock
        self._trouble = trouble
        self._lots = np.random.default_rng(3)
        self._kept: deque[tuple[int, bytes]] = deque()
        self._seen = 0
        self._reader = PacketReader()
        self.sent: list[tuple[float, Any]] = []

    def send(self, data: bytes) -> None:
        message = mavlink.MAVLink(None).decode(bytearray(data))
        self.sent.append((self._clock.now(), message))
        for packet in self._shaken([data]):
            super().send(packet)

    def receive(self) -> bytes:
        packets = [packet.data for packet in self._reader.feed(super().receive())]
        return b"".join(self._shaken(packets))

    def of(self, message_id: int) -> list[tuple[float, Any]]:
        return [(at, m) for at, m in list(self.sent) if m.get_msgId() == message_id]

    def _shaken(self, packets: list[bytes]) -> Iterator[bytes]:
        for packet in packets:
            fate = float(self._lots.random()) / self._trouble if self._trouble else 9.0
            if fate < 1.0:
                pass  # lost
            elif fate < 1.5:
                self._kept.append((self._seen + 5, packet))  # comes after five others
            else:
                yield packet
                yield from ([packet] if fate < 2.0 else [])  # doubled
            self._seen += 1
            while self._kept and self._kept[0][0] <= self._seen:
                yield self._kept.popleft()[1]


class SigningPeer(WrappedTransport):
    """Makes a simulated autopilot one that signs, and obeys only what is signed."""

    def __init__(self, inner: Transport, clock: Clock) -> None:
        super().__init__(inner)
        self._clock = clock
        self._signer = Signer(SigningKey(SECRET), EPOCH_NS)
        self._reader = PacketReader()
        self.refused = 0

    def send(self, data: bytes) -> None:
        super().send(self._signer.sign(data, self._clock.now()))

    def receive(self) -> bytes:
        good = b""
        for packet in self._reader.feed(super().receive()):
            refusal = self._signer.refusal(packet, self._clock.now())
            self.refused += refusal is not None
            good += b"" if refusal is not None else packet.data
        return good


class Rig:
    """A simulated autopilot on one side of a wire, a link on the other.

    On a simulated clock the autopilot is stepped while time passes, else it has a thread.
    """

    def __init__(
        self,
        link: Link,
        wire: LossyTransport,
        theirs: Transport,
        stranger: Transport,
        flavour: str,
    ) -> None:
        self.link = link
        self.wire = wire
        self.clock = wire._clock
        self.stranger = stranger
        self._theirs = theirs
        self._flavour = flavour
        self._thread: threading.Thread | None = None

    def boot(self, height_m: float) -> None:
        """Start an autopilot."""
        start = BodyState(self.clock.now(), (0.0, 0.0, -height_m))
        self.autopilot = SimAutopilot(self._flavour, self._theirs, start)
        self._stop = threading.Event()
        if isinstance(self.clock, MonotonicClock):
            arguments = (self.autopilot, self.clock, self._stop)
            self._thread = threading.Thread(target=run_autopilot, args=arguments)
            self._thread.start()

    def cut_power(self) -> None:
        """End the autopilot."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def wait(self, seconds: float) -> None:
        """Let time pass without a control loop."""
        end_s = self.clock.now() + seconds
        while self._thread is None and self.clock.now() + STEP_S < end_s:
            self.clock.sleep_until(self.clock.now() + STEP_S)
            if not self._stop.is_set():
                self.autopilot.step(self.clock.now())
        self.clock.sleep_until(end_s)

    def run(
        self,
        done: Callable[[], bool] | None = None,
        setpoint: VelocitySetpoint | None = None,
        for_s: float = _PATIENCE_S,
    ) -> None:
        """Be a control loop at 50 Hz until something is so, or for some time."""
        end_s = self.clock.now() + for_s
        while self.clock.now() < end_s:
            now_s = self.clock.now()
            self.link.poll(now_s)
            if setpoint is not None:
                self.link.send(setpoint)
            if done is not None and done():
                return
            self.wait(now_s + 0.02 - self.clock.now())
        assert done is None, f"waited in vain; {self.link.status(self.clock.now())}"

    def connect(self) -> None:
        self.run(lambda: self.link.state.attitude is not None)

    def enter_setpoint_mode(self) -> None:
        """Stream zeros, as PX4 wants, and ask for the mode until it is there."""
        asked_s = -9.0

        def entered() -> bool:
            nonlocal asked_s
            if self.clock.now() - asked_s > 1.0:
                asked_s = self.clock.now()
                self.link.enter_setpoint_mode()
            return self.link.state.obeys_setpoints

        self.run(setpoint=HOLD, for_s=0.1)
        self.run(entered, HOLD)


@contextmanager
def rig(
    kind: LinkKind,
    flavour: str,
    trouble: float = 0.0,
    height_m: float = 20.0,
    key: Path | None = None,
) -> Iterator[Rig]:
    clock, (ours, theirs, stranger) = (
        (MonotonicClock(), udp_ends()) if kind == "mavsdk" else (SimulatedClock(), memory_ends())
    )
    if key is not None:
        theirs = SigningPeer(theirs, clock)
    wire = LossyTransport(ours, clock, trouble)
    key_file = None if key is None else str(key)
    settings = LinkSettings(kind=kind, vehicle_id=1, signing_key_file=key_file)
    link = open_link(wire, settings, clock, EPOCH_NS)
    flight = Rig(link, wire, theirs, stranger, flavour)
    flight.boot(height_m)
    try:
        yield flight
    finally:
        flight.link.close()
        flight.cut_power()
        theirs.close()
        stranger.close()


def udp_ends() -> tuple[Transport, Transport, Transport]:
    """Return the link's end, the autopilot's and a stranger's."""
    ours = UdpTransport.listen("127.0.0.1", 0)
    theirs, stranger = (UdpTransport.connect("127.0.0.1", ours.port) for _ in range(2))
    return ours, theirs, stranger


def memory_ends() -> tuple[Transport, Transport, Transport]:
    """Return the link's end, the autopilot's and a stranger's."""
    inbox, outbox, nothing = deque[bytes](), deque[bytes](), deque[bytes]()
    return (
        MemoryTransport(inbox, outbox),
        MemoryTransport(outbox, inbox),
        MemoryTransport(nothing, inbox),
    )
