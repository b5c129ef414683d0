"""What an independent watcher sees: the packets on the wire and the vehicle's true motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower_control.transport import Transport
from follower_sim.autopilot import SimAutopilot
from follower_sim.firmware import ARDUCOPTER, PX4
from follower_sim.kinematics import Triple
from follower_vision.clock import Clock

SETPOINT_MODES = {"px4": PX4.setpoint_mode, "ardupilot": ARDUCOPTER.setpoint_mode}
_KEPT = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "HEARTBEAT", "COMMAND_LONG"})


@dataclass(frozen=True, slots=True)
class WireSetpoint:
    """A set-point as it went over the wire.

    Attributes:
        time_s: when, on the flight's clock.
        frame, mask: MAVLink's.
        values: forward, right, down (m/s), yaw rate (rad/s).
    """

    time_s: float
    frame: int
    mask: int
    values: tuple[float, float, float, float]

    @property
    def is_zero(self) -> bool:
        """Whether it asks to stand still."""
        return all(abs(value) < 1e-6 for value in self.values)

    @property
    def speed_m_s(self) -> float:
        """Of the velocity asked for."""
        return math.hypot(*self.values[:3])


@dataclass(frozen=True, slots=True)
class Motion:
    """The vehicle's truth at one moment."""

    time_s: float
    position_m: Triple
    velocity_m_s: Triple
    mode: str
    obeys: bool
    armed: bool

    @property
    def speed_m_s(self) -> float:
        """Of the vehicle."""
        return math.hypot(*self.velocity_m_s)


class WireTap:
    """A transport that does the same as another one, and notes what goes through it.

    It has a MAVLink parser of its own, pymavlink's, and believes no signature and no sender.

    Attributes:
        sent: (time, message) that left through it.
        heard: (time, message) that came.
    """

    def __init__(self, inner: Transport, clock: Clock) -> None:
        self._inner = inner
        self._clock = clock
        self._out, self._in = _parser(), _parser()
        self.sent: list[tuple[float, Any]] = []
        self.heard: list[tuple[float, Any]] = []

    def send(self, data: bytes) -> None:
        """Send one packet and note it."""
        self.sent += self._messages(self._out, data)
        self._inner.send(data)

    def receive(self) -> bytes:
        """Return what has arrived and note it."""
        data = self._inner.receive()
        self.heard += self._messages(self._in, data)
        return data

    def close(self) -> None:
        """Close the transport."""
        self._inner.close()

    def _messages(self, parser: Any, data: bytes) -> list[tuple[float, Any]]:
        now_s = self._clock.now()
        messages = parser.parse_buffer(data) or []
        return [(now_s, message) for message in messages if message.get_type() in _KEPT]


def _parser() -> Any:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return parser


@dataclass(slots=True)
class Evidence:
    """All that is known of a flight without asking the follower.

    Attributes:
        flavour: "px4" or "ardupilot".
        motion: the vehicle's truth, step by step.
        setpoints: that the follower sent.
        told_s: when a heartbeat came to the follower, and whether it told of the mode that flies
            set-points.
    """

    flavour: str
    motion: list[Motion] = field(default_factory=list)
    setpoints: list[WireSetpoint] = field(default_factory=list)
    told_s: list[tuple[float, bool]] = field(default_factory=list)

    def watch(self, autopilot: SimAutopilot, now_s: float) -> None:
        """Look at the vehicle."""
        state = autopilot.state
        obeys = autopilot.mode == SETPOINT_MODES[self.flavour]
        motion = Motion(
            now_s, state.position_m, state.velocity_m_s, autopilot.mode, obeys, autopilot.armed
        )
        if not self.motion or now_s > self.motion[-1].time_s:
            self.motion.append(motion)

    def read(self, follower_sent: list[tuple[float, Any]], heard: list[tuple[float, Any]]) -> None:
        """Take what a tap noted on the follower's side."""
        modes = PX4.modes if self.flavour == "px4" else ARDUCOPTER.modes
        number = modes[SETPOINT_MODES[self.flavour]].custom_mode
        for time_s, message in follower_sent:
            if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                self.setpoints.append(_setpoint(time_s, message))
        for time_s, message in heard:
            is_vehicles = (message.get_srcSystem(), message.get_srcComponent()) == (1, 1)
            if message.get_type() == "HEARTBEAT" and is_vehicles:
                self.told_s.append((time_s, message.custom_mode == number))


def _setpoint(time_s: float, m: Any) -> WireSetpoint:
    return WireSetpoint(time_s, m.coordinate_frame, m.type_mask, (m.vx, m.vy, m.vz, m.yaw_rate))
