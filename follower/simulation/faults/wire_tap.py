"""What an independent watcher sees: the packets on the wire and the vehicle's true motion."""

import math
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower_control.common.transport import Transport, WrappedTransport
from follower_sim.autopilot.autopilot import COMPONENT_ID, SYSTEM_ID, SimAutopilot
from follower_sim.autopilot.firmware import ARDUCOPTER, PX4
from follower_sim.kinematics import Triple
from follower_vision.clock import Clock

FIRMWARE = {"px4": PX4, "ardupilot": ARDUCOPTER}
_KEPT = frozenset({"SET_POSITION_TARGET_LOCAL_NED", "HEARTBEAT", "COMMAND_LONG"})


@dataclass(frozen=True, slots=True)
class WireSetpoint:
    """A setpoint as it went over the wire.

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
        """Speed of the velocity asked for, m/s."""
        return math.hypot(*self.values[:3])


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """The vehicle's true state at one time: metres and m/s, north, east, down."""

    time_s: float
    position_m: Triple
    velocity_m_s: Triple
    mode: str
    obeys: bool
    armed: bool

    @property
    def speed_m_s(self) -> float:
        """True speed, m/s."""
        return math.hypot(*self.velocity_m_s)


class WireTap(WrappedTransport):
    """A transport that does the same as another one, and notes what goes through it.

    It has a MAVLink parser of its own, pymavlink's, and believes no signature and no sender.

    Attributes:
        sent: (time, message) that left through it.
        received: (time, message) that came.
    """

    def __init__(self, inner: Transport, clock: Clock) -> None:
        super().__init__(inner)
        self._clock = clock
        self._out, self._in = _parser(), _parser()
        self.sent: list[tuple[float, Any]] = []
        self.received: list[tuple[float, Any]] = []

    def send(self, data: bytes) -> None:
        """Send one packet and note it."""
        self.sent += self._messages(self._out, data)
        super().send(data)

    def receive(self) -> bytes:
        """Return what has arrived and note it."""
        data = super().receive()
        self.received += self._messages(self._in, data)
        return data

    def _messages(self, parser: Any, data: bytes) -> list[tuple[float, Any]]:
        now_s = self._clock.now()
        messages = parser.parse_buffer(data) or []
        return [(now_s, message) for message in messages if message.get_type() in _KEPT]


def _parser() -> Any:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return parser


@dataclass(slots=True)
class FlightEvidence:
    """All that is known of a flight without asking the follower.

    Attributes:
        flavour: "px4" or "ardupilot".
        motion: the vehicle's truth, step by step.
        setpoints: that the follower sent.
        mode_heartbeats: when each heartbeat reached the follower, s, and whether its mode is the
            one that flies setpoints.
    """

    flavour: str
    motion: list[TrueMotion] = field(default_factory=list)
    setpoints: list[WireSetpoint] = field(default_factory=list)
    mode_heartbeats: list[tuple[float, bool]] = field(default_factory=list)

    def watch(self, autopilot: SimAutopilot, now_s: float) -> None:
        """Take the vehicle's true state."""
        state = autopilot.state
        obeys = autopilot.mode == FIRMWARE[self.flavour].setpoint_mode
        motion = TrueMotion(
            now_s, state.position_m, state.velocity_m_s, autopilot.mode, obeys, autopilot.armed
        )
        if not self.motion or now_s > self.motion[-1].time_s:
            self.motion.append(motion)

    def read(
        self,
        follower_sent: list[tuple[float, Any]],
        received: list[tuple[float, Any]],
        vehicle_id: int = SYSTEM_ID,
    ) -> None:
        """Take what a tap noted on the follower's side, (seconds, message) each.

        Args:
            follower_sent: what left the follower.
            received: what came to it.
            vehicle_id: the autopilot's MAVLink system id.
        """
        firmware = FIRMWARE[self.flavour]
        number = firmware.modes[firmware.setpoint_mode].custom_mode
        for time_s, message in follower_sent:
            if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
                values = message.vx, message.vy, message.vz, message.yaw_rate
                frame, mask = message.coordinate_frame, message.type_mask
                self.setpoints.append(WireSetpoint(time_s, frame, mask, values))
        for time_s, message in received:
            source = message.get_srcSystem(), message.get_srcComponent()
            is_vehicles = source == (vehicle_id, COMPONENT_ID)
            if message.get_type() == "HEARTBEAT" and is_vehicles:
                self.mode_heartbeats.append((time_s, message.custom_mode == number))
