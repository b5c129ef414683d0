"""Bytes in, messages out, and the other way round: one end of a MAVLink 2 link."""

from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower_control.common.transport import Transport


@dataclass(slots=True)
class Faults:
    """Switches that a test or a scenario throws while the flight goes on.

    Attributes:
        silent: nothing is sent at all, not even answers; the vehicle flies on.
        telemetry_stopped: nothing but heartbeats and answers is sent.
        attitude_frozen: ATTITUDE repeats its numbers with new times.
        attitude_nan: ATTITUDE carries NaN.
        position_frozen: LOCAL_POSITION_NED repeats its numbers with new times.
        position_nan: it carries NaN.
        position_stopped: it is not sent, as when the estimator has no position.
        position_jump_m: LOCAL_POSITION_NED is so many metres too far north.
        yaw_jump_rad: added to ATTITUDE's yaw, radians.
        clock_jump_s: the autopilot's clock jumps ahead by so many seconds.
        refuses_setpoints: the mode that flies setpoints is not entered.
        refused_modes: names of modes that are not entered.
        deaf: nothing that arrives is received.
    """

    silent: bool = False
    telemetry_stopped: bool = False
    attitude_frozen: bool = False
    attitude_nan: bool = False
    position_frozen: bool = False
    position_nan: bool = False
    position_stopped: bool = False
    position_jump_m: float = 0.0
    yaw_jump_rad: float = 0.0
    clock_jump_s: float = 0.0
    refuses_setpoints: bool = False
    refused_modes: tuple[str, ...] = ()
    deaf: bool = False


class MavlinkEndpoint:
    """Encodes and decodes for one system, and is as silent and deaf as `faults` says.

    Args:
        transport: carries the bytes.
        system, component: ids of the sender in every message.
        faults: read at every packet.
    """

    def __init__(self, transport: Transport, system: int, component: int, faults: Faults) -> None:
        self._transport = transport
        self._codec = mavlink.MAVLink(None, system, component)
        self._codec.robust_parsing = True
        self._faults = faults

    def receive(self) -> list[Any]:
        """Return the messages that have arrived; broken ones are left out."""
        data = self._transport.receive()
        messages = (self._codec.parse_buffer(data) if data else None) or []
        good = [message for message in messages if message.get_type() != "BAD_DATA"]
        return [] if self._faults.deaf else good

    def send(self, message: Any) -> None:
        """Send one message."""
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        if not self._faults.silent:
            self._transport.send(data)
