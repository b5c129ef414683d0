"""An autopilot and its vehicle, as cheap as can be: one step of both is one step of control."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower.faults.campaign.wire_watch import setpoint_in
from follower_control.transport import Transport
from follower_sim.firmware import ARDUCOPTER, PX4, Firmware
from follower_sim.flight_modes import FlightMode
from follower_sim.kinematics import Triple

_LAG_S = 0.4
_YAW_LAG_S = 0.2
_PX4_LOSS_S, _ARDUCOPTER_LOSS_S = 1.25, 3.0
_RETURN_M_S = 2.0
_HEAD_AND_CHECKSUM = 12
_HEARD = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_TIMESYNC)
FIRMWARE = {"px4": PX4, "ardupilot": ARDUCOPTER}


class CheapVehicle:
    """Flies velocities with a first-order lag, and has the modes and time-outs that matter.

    In place of physics there is one time constant; in place of the autopilot's code there are its
    rules for the stream of set-points. It speaks MAVLink in bytes.

    Args:
        flavour: "px4" or "ardupilot".
        transport: the autopilot's end.
        rng: of its telemetry's noise and times.
        start: where it hovers.
        now_s: now.

    Attributes:
        distort: is handed every message of telemetry and may change it, or return None for none.
    """

    def __init__(
        self,
        flavour: str,
        transport: Transport,
        rng: np.random.Generator,
        start: Triple,
        now_s: float,
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
        self.boot_s = now_s - 30.0
        self.distort: Callable[[Any], Any] = lambda message: message
        self._setpoint = (0.0, 0.0, 0.0, 0.0)
        self._setpoint_s = -math.inf
        self._now_s = now_s
        self._count = 0
        self._beat_s = -math.inf

    @property
    def obeys(self) -> bool:
        """Whether it flies set-points."""
        return self.mode.name == self.firmware.setpoint_mode

    @property
    def speed_m_s(self) -> float:
        """The true speed."""
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
        """Hear, fly and tell."""
        self._now_s = now_s
        data = self._transport.receive()
        while data:
            length = _HEAD_AND_CHECKSUM + data[1]
            self._hear(data[:length])
            data = data[length:]
        self._watch_stream()
        self._fly(min(interval_s, 0.1))
        self._tell()

    def _hear(self, packet: bytes) -> None:
        """Take one of the follower's packets: they come whole, or not at all."""
        number = int.from_bytes(packet[7:10], "little")
        if number == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            if self.obeys or self.firmware.name == "px4":
                self._setpoint = setpoint_in(packet, self._now_s).values
                self._setpoint_s = self._now_s
        elif number in _HEARD:
            self._take(self._codec.decode(bytearray(packet)))

    def _take(self, m: Any) -> None:
        if m.get_type() == "TIMESYNC" and m.tc1 == 0:
            since_boot = round((self._now_s - self.boot_s) * 1e9)
            self._send(mavlink.MAVLink_timesync_message(since_boot, m.ts1))
        elif m.get_type() == "COMMAND_LONG" and m.command == mavlink.MAV_CMD_DO_SET_MODE:
            self._set_mode(m)

    def _set_mode(self, m: Any) -> None:
        number = int(m.param2)
        if self.firmware.name == "px4":
            number = int(m.param2) << 16 | int(m.param3) << 24
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

    def _tell(self) -> None:
        self._count += 1
        boot_ms = round((self._now_s - self.boot_s) * 1000.0) & 0xFFFFFFFF
        tremble = self._rng.normal(0.0, 1e-3, 6).tolist()
        rates = (tremble[3], tremble[4], self.yaw_rate_rad_s + tremble[5])
        yaw = math.remainder(self.yaw_rad + tremble[2], math.tau)
        self._send(mavlink.MAVLink_attitude_message(boot_ms, *tremble[:2], yaw, *rates))
        if self._count % 2:
            place = [p + t for p, t in zip(self.position_m, tremble, strict=False)]
            pace = [v + t for v, t in zip(self.velocity_m_s, tremble[3:], strict=True)]
            self._send(mavlink.MAVLink_local_position_ned_message(boot_ms, *place, *pace))
        if self._count % 25 == 0:
            landed = 1 if self.landed else 2
            self._send(mavlink.MAVLink_extended_sys_state_message(0, landed))
        if self._now_s - self._beat_s >= 1.0:
            self._beat_s = self._now_s
            self._send(self._heartbeat())

    def _heartbeat(self) -> Any:
        flags = 1 | (128 if self.armed else 0)
        status = mavlink.MAV_STATE_CRITICAL if self.in_failsafe else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            2, self.firmware.mav_autopilot, flags, self.mode.custom_mode, status, 3
        )

    def _send(self, message: Any) -> None:
        message = self.distort(message)
        if message is not None:
            try:
                data = message.pack(self._codec)
            except struct.error:
                return  # a number too large for its field cannot be sent
            self._codec.seq = (self._codec.seq + 1) % 256
            self._transport.send(data)
