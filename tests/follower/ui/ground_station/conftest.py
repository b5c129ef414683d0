"""A follower with a ground station's link, a flight to look at, and a network that loses packets.

Packets go over real UDP on loopback; time is the test's own, so that QGroundControl's seconds of
waiting cost none.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.log import FlightLog, TrackRecord
from follower.flight.operator_requests import OperatorRequests
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.link import LinkSettings
from follower.settings.settings import Settings
from follower.settings.ui import GroundStationSettings
from follower.ui.ground_station.flight_view import CameraOptics, FlightView
from follower.ui.ground_station.server import GroundStation
from follower_control.common.transport import Transport, UdpTransport
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import Track, TrackState

WIDTH, HEIGHT, STEP_S = 640, 480, 0.02
LOOPBACK = "127.0.0.1"


class SharedTransport:
    """The autopilot's end and a ground station's, on one link."""

    def __init__(self, *ends: Transport) -> None:
        self._ends = ends

    def send(self, data: bytes) -> None:
        for end in self._ends:
            end.send(data)

    def receive(self) -> bytes:
        return b"".join(end.receive() for end in self._ends)

    def close(self) -> None:
        for end in self._ends:
            end.close()


@pytest.fixture(scope="session")
def share() -> Callable[..., Transport]:
    return SharedTransport


class Peer:
    """Somebody on the network: sends as one component, hears everything.

    Args:
        port: of the follower.
        loss: share of the packets that are lost, each way.
        seed: of the losses.
    """

    def __init__(
        self, port: int, system: int, component: int, loss: float = 0.0, seed: int = 1
    ) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._address = LOOPBACK, port
        self._codec = mavlink.MAVLink(None, system, component)
        self._codec.robust_parsing = True
        self._lots, self._loss = np.random.default_rng(seed), loss
        self.messages: list[Any] = []
        self._hello_s = -math.inf

    def say_hello(self, now_s: float) -> None:
        """Send a ground station's heartbeat once a second."""
        if now_s - self._hello_s >= 1.0:
            self._hello_s = now_s
            self.send(gcs_heartbeat())

    def send(self, message: Any) -> None:
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        if self._lots.random() >= self._loss:
            self._socket.sendto(data, self._address)

    def hear(self) -> list[Any]:
        """Return the messages that have come and were not lost."""
        heard = []
        while True:
            try:
                data = self._socket.recv(65535)
            except BlockingIOError:
                break
            for message in self._codec.parse_buffer(bytearray(data)) or ():
                if self._lots.random() >= self._loss:
                    heard.append(message)
        self.messages += heard
        return heard

    def of(self, name: str, component: int | None = None) -> list[Any]:
        """Return the messages of a kind heard so far."""
        return [
            one
            for one in self.messages
            if one.get_type() == name and component in (None, one.get_srcComponent())
        ]

    def command(self, number: int, *params: float, component: int = 100, confirmation: int = 0):
        padded = (*params, *([0.0] * (7 - len(params))))
        self.send(mavlink.MAVLink_command_long_message(1, component, number, confirmation, *padded))

    def close(self) -> None:
        self._socket.close()


@dataclass
class Rig:
    """The follower's side, stepped by hand."""

    settings: Settings
    station: GroundStation
    link: MavlinkLink
    view: FlightView
    autopilot: Peer
    port: int
    stack: ExitStack
    clock: SimulatedClock
    everybody: list[Any] = field(default_factory=list)

    @property
    def now_s(self) -> float:
        return self.clock.now()

    @property
    def requests(self) -> OperatorRequests:
        return self.view.requests

    def peer(self, system: int = 255, component: int = 190, **options: Any) -> Peer:
        """Return somebody who says hello at once."""
        peer = Peer(self.port, system, component, **options)
        self.stack.callback(peer.close)
        peer.send(gcs_heartbeat())
        return peer

    def station_peer(self, **options: Any) -> Peer:
        """Return somebody whom every step hears, after the first ones."""
        peer = self.peer(**options)
        self.everybody.append(peer)
        self.run(0.1)
        return peer

    def run(self, seconds: float, each: Callable[[float], object] = float) -> None:
        """Let time pass; `each` is called with every moment."""
        for _ in range(round(seconds / STEP_S)):
            self.clock.sleep_until(self.now_s + STEP_S)
            if round(self.now_s / STEP_S) % 50 == 1:
                self.autopilot.send(autopilot_heartbeat())
            each(self.now_s)
            self.link.poll(self.now_s)
            self.station.step(self.now_s)
            self.autopilot.hear()
            for one in self.everybody:
                one.hear()

    def show(self, box: Box | None, state: TrackState = TrackState.TRACKING) -> None:
        """Have vision say this now."""
        now_s, number = self.now_s, len(self.view.log.tracks)
        track = None if box is None else Track(box, state, 0.9, "test", now_s, number)
        self.view.log.add_track(TrackRecord(track, number, now_s, now_s, now_s, 0.001))


def autopilot_heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 4, 3)


def gcs_heartbeat() -> Any:
    gcs, none = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
    return mavlink.MAVLink_heartbeat_message(gcs, none, 0, 0, 4, 3)


MakeRig = Callable[..., Rig]


@pytest.fixture
def make_rig() -> Iterator[MakeRig]:
    """Return the maker of rigs; keywords are ground station settings."""
    with ExitStack() as stack:

        def make(save: Callable[[], str] | None = None, **options: Any) -> Rig:
            ground = GroundStationSettings(enabled=True, **options)
            settings = Settings(ground_station=ground)
            transport = UdpTransport.listen(LOOPBACK, 0)
            link = MavlinkLink(transport, LinkSettings(vehicle_id=1))
            stack.callback(link.close)
            requests, log, clock = OperatorRequests(settings), FlightLog(), SimulatedClock()
            view = FlightView(log, link, requests, (WIDTH, HEIGHT))
            station = GroundStation(ground, view, CameraOptics(70.0, 30.0), clock, save)
            autopilot = Peer(transport.port, 1, 1)
            stack.callback(autopilot.close)
            rig = Rig(settings, station, link, view, autopilot, transport.port, stack, clock)
            rig.run(0.1)
            return rig

        yield make


@pytest.fixture
def rig(make_rig: MakeRig) -> Rig:
    """The usual one."""
    return make_rig()


@pytest.fixture
def qgc(rig: Rig) -> Peer:
    """A ground station that hears the usual one."""
    return rig.station_peer()
