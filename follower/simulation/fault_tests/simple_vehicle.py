"""An autopilot and its vehicle, in their simplest form: one step of both is one control step."""

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.generator.mavcrc import x25crc

from follower.simulation.faults.wire_tap import FIRMWARE, WireSetpoint
from follower_control.common.transport import Transport, WrappedTransport
from follower_sim.autopilot.firmware import Firmware, FlightMode
from follower_sim.kinematics import Triple

_SETPOINT = 84
_HEAD, _SETPOINT_LENGTH = 10, 53
_SETPOINT_FIELDS = struct.Struct("<I11fHBBB")
_HEARTBEAT_LENGTH, _HEARTBEAT_SEED = 9, 50
_FROM_VEHICLE = bytes((1, 1, 0, 0, 0))
"""System, component and message id, as they stand in a heartbeat's head."""


class WireWatch(WrappedTransport):
    """A transport of the follower's that notes setpoints sent and heartbeats received.

    Packets are taken apart by their bytes, without anybody's MAVLink parser. It stands before the
    faults: what it sees arrive is what the follower gets.

    Attributes:
        now_s: set from outside.
        setpoints: that left; whoever reads them empties the list.
        modes: `custom_mode` of the vehicle's heartbeats that came; likewise.
    """

    def __init__(self, inner: Transport) -> None:
        super().__init__(inner)
        self.now_s = 0.0
        self.setpoints: list[WireSetpoint] = []
        self.modes: list[int] = []

    def send(self, data: bytes) -> None:
        """Send one packet, and note the setpoint in it."""
        if int.from_bytes(data[7:10], "little") == _SETPOINT:
            self.setpoints.append(setpoint_in(data, self.now_s))
        super().send(data)

    def receive(self) -> bytes:
        """Return what has arrived, and note the heartbeats in it."""
        data = super().receive()
        at = data.find(_FROM_VEHICLE)
        while at >= 0:
            self._observe(data[max(0, at - 5) : at + 16])
            at = data.find(_FROM_VEHICLE, at + 1)
        return data

    def _observe(self, packet: bytes) -> None:
        whole = len(packet) == _HEAD + _HEARTBEAT_LENGTH + 2
        if not whole or packet[0] != 0xFD or packet[1] != _HEARTBEAT_LENGTH:
            return
        checksum = int(x25crc(packet[1:-2] + bytes((_HEARTBEAT_SEED,))).crc)
        if checksum == int.from_bytes(packet[-2:], "little"):
            self.modes.append(int.from_bytes(packet[_HEAD : _HEAD + 4], "little"))


def setpoint_in(data: bytes, now_s: float) -> WireSetpoint:
    """Return the setpoint in a packet of that message: m/s and rad/s, received at `now_s`."""
    payload = data[_HEAD : _HEAD + data[1]].ljust(_SETPOINT_LENGTH, b"\0")
    fields = _SETPOINT_FIELDS.unpack(payload)
    vx, vy, vz = fields[4:7]
    return WireSetpoint(now_s, fields[15], fields[12], (vx, vy, vz, fields[11]))


_LAG_S = 0.4
_YAW_LAG_S = 0.2
_PX4_LOSS_S, _ARDUCOPTER_LOSS_S = 1.25, 3.0
_RETURN_M_S = 2.0
_HEAD_AND_CHECKSUM = 12
_UNDERSTOOD = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_TIMESYNC)


class SimpleVehicle:
    """Flies velocities with a first-order lag, and has the modes and time-outs that matter.

    In place of physics there is one time constant; in place of the autopilot's code there are its
    rules for the stream of setpoints. It speaks MAVLink in bytes.

    Args:
        flavour: "px4" or "ardupilot".
        transport: the autopilot's end.
        rng: of its telemetry's noise and times.
        start: where it hovers at time 0, metres, north, east, down.

    Attributes:
        distort: is handed every message of telemetry and may change it, or return None for none.
    """

    def __init__(
        self,
        flavour: str,
        transport: Transport,
        rng: np.random.Generator,
        start: Triple,
    ) -> None:
        self.firmware: Firmware = FIRMWARE[flavour]
        self._transport = transport
        self._rng = rng
        self._codec = mavlink.MAVLink(None, 1, 1)
        self.position_m = list(start)
        self.velocity_m_s = [0.0, 0.0, 0.0]
        self.yaw_rad = float(rng.uniform(-math.pi, math.pi))
        self.yaw_rate_rad_s = 0.0
        self.mode: FlightMode = self.firmware.modes[self.firmware.hold_mode]
        self.armed = True
        self.landed = False
        self.in_failsafe = False
        self.refuses = False
        self.obeys_since_s = -math.inf
        self.boot_s = -30.0
        self.distort: Callable[[Any], Any] = lambda message: message
        self._setpoint = (0.0, 0.0, 0.0, 0.0)
        self._setpoint_s = -math.inf
        self._now_s = 0.0
        self._count = 0
        self._beat_s = -math.inf

    @property
    def obeys(self) -> bool:
        """Whether it flies setpoints."""
        return self.mode.name == self.firmware.setpoint_mode

    @property
    def speed_m_s(self) -> float:
        """The true speed, m/s."""
        return math.hypot(*self.velocity_m_s)

    def enter(self, name: str) -> None:
        """Take a mode, as a pilot's switch does it, if it may be entered."""
        runs = self._now_s - self._setpoint_s < 1.0 or self.firmware.name != "px4"
        if name == self.firmware.setpoint_mode and (self.refuses or not runs):
            return
        self.mode = self.firmware.modes[name]
        self.in_failsafe = False
        self._setpoint = (0.0, 0.0, 0.0, 0.0)
        self.obeys_since_s = self._now_s

    def step(self, now_s: float, interval_s: float) -> None:
        """Take packets, move the vehicle by `interval_s` seconds to `now_s`, send telemetry."""
        self._now_s = now_s
        data = self._transport.receive()
        while data:
            length = _HEAD_AND_CHECKSUM + data[1]
            self._receive(data[:length])
            data = data[length:]
        self._watch_stream()
        self._fly(min(interval_s, 0.1))
        self._send_telemetry()

    def _receive(self, packet: bytes) -> None:
        """Take one of the follower's packets: they come whole, or not at all."""
        number = int.from_bytes(packet[7:10], "little")
        if number == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            if self.obeys or self.firmware.name == "px4":
                self._setpoint = setpoint_in(packet, self._now_s).values
                self._setpoint_s = self._now_s
        elif number in _UNDERSTOOD:
            self._take(self._codec.decode(bytearray(packet)))

    def _take(self, m: Any) -> None:
        if m.get_type() == "TIMESYNC" and m.tc1 == 0:
            since_boot = round((self._now_s - self.boot_s) * 1e9)
            self._send(mavlink.MAVLink_timesync_message(since_boot, m.ts1))
        elif m.get_type() == "COMMAND_LONG" and m.command == mavlink.MAV_CMD_DO_SET_MODE:
            number = int(m.param2)
            if self.firmware.name == "px4":
                number = number << 16 | int(m.param3) << 24
            mode = self.firmware.mode_of(number)
            if mode is not None:
                self.enter(mode.name)

    def _watch_stream(self) -> None:
        silent_s = self._now_s - self._setpoint_s
        if self.firmware.name != "px4":
            if silent_s > _ARDUCOPTER_LOSS_S:
                self._setpoint = (0.0, 0.0, 0.0, 0.0)
        elif self.obeys and silent_s > _PX4_LOSS_S:
            self.mode, self.in_failsafe = self.firmware.modes["RTL"], True
        elif self.in_failsafe and silent_s <= _PX4_LOSS_S:
            self.mode, self.in_failsafe = self.firmware.modes["OFFBOARD"], False
            self.obeys_since_s = self._now_s

    def _fly(self, interval_s: float) -> None:
        forward, right, down, yaw_rate = self._setpoint if self.obeys else (0.0, 0.0, 0.0, 0.0)
        if self.mode.name == "RTL":
            down = -_RETURN_M_S if self.position_m[2] > -15.0 else 0.0
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        wanted = (c * forward - s * right, s * forward + c * right, down)
        share = 1.0 - math.exp(-interval_s / _LAG_S)
        for axis in range(3):
            change = share * (wanted[axis] - self.velocity_m_s[axis])
            self.velocity_m_s[axis] += min(max(change, -8.0 * interval_s), 8.0 * interval_s)
            self.position_m[axis] += interval_s * self.velocity_m_s[axis]
        share = 1.0 - math.exp(-interval_s / _YAW_LAG_S)
        self.yaw_rate_rad_s += share * (yaw_rate - self.yaw_rate_rad_s)
        self.yaw_rad = math.remainder(self.yaw_rad + interval_s * self.yaw_rate_rad_s, math.tau)
        if self.position_m[2] > 0.0:
            self.position_m[2], self.velocity_m_s[2] = 0.0, min(self.velocity_m_s[2], 0.0)

    def _send_telemetry(self) -> None:
        self._count += 1
        boot_ms = round((self._now_s - self.boot_s) * 1000.0) & 0xFFFFFFFF
        noise = self._rng.normal(0.0, 1e-3, 6).tolist()
        rates = (noise[3], noise[4], self.yaw_rate_rad_s + noise[5])
        yaw = math.remainder(self.yaw_rad + noise[2], math.tau)
        self._send(mavlink.MAVLink_attitude_message(boot_ms, *noise[:2], yaw, *rates))
        if self._count % 2:
            position = [p + t for p, t in zip(self.position_m, noise, strict=False)]
            velocity = [v + t for v, t in zip(self.velocity_m_s, noise[3:], strict=True)]
            self._send(mavlink.MAVLink_local_position_ned_message(boot_ms, *position, *velocity))
        if self._count % 25 == 0:
            landed = 1 if self.landed else 2
            self._send(mavlink.MAVLink_extended_sys_state_message(0, landed))
        if self._now_s - self._beat_s >= 1.0:
            self._beat_s = self._now_s
            flags = 1 | (128 if self.armed else 0)
            status = mavlink.MAV_STATE_CRITICAL if self.in_failsafe else mavlink.MAV_STATE_ACTIVE
            kind, mode = self.firmware.mav_autopilot, self.mode.custom_mode
            self._send(mavlink.MAVLink_heartbeat_message(2, kind, flags, mode, status, 3))

    def _send(self, message: Any) -> None:
        message = self.distort(message)
        if message is not None:
            try:
                data = message.pack(self._codec)
            except struct.error:
                return  # a number too large for its field cannot be sent
            self._codec.seq = (self._codec.seq + 1) % 256
            self._transport.send(data)
