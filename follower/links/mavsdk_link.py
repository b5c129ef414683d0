"""The mavsdk link: the same vehicle through MAVSDK's own stack."""

import contextlib
import json
import logging
import math
import struct
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.logging import LogLevel, log_subscribe
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectError, MavlinkMessage
from mavsdk.plugins.offboard import Offboard, OffboardError, VelocityBodyYawspeed
from mavsdk.system import System
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.link import AUTOPILOT_ID, COMPONENT_ID, Link
from follower.links.packet_parser import MavlinkPacket, Unpacker, message_id_of
from follower.links.signing import Signer
from follower.links.vehicle_finder import FoundVehicle
from follower.links.vehicle_monitor import mode_name, setpoint_mode
from follower.settings.link import LinkSettings
from follower_control.common.transport import Transport
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_vision.clock import Clock

_PUMP_S = 0.005
_MOST_PACKETS = 5000
_LONGEST_ANSWER_S = 5.0
_LOGGER = logging.getLogger("mavsdk")
_LEVELS = {LogLevel.WARN: logging.INFO, LogLevel.ERROR: logging.WARNING}
_STOP_AFTER_S = 0.1
_HEADER, _VELOCITY, _YAW_RATE = 10, 16, 44
"""Where a packet's payload begins, and in it a setpoint's velocity and yaw rate, bytes."""


def stands_still(packet: bytes) -> bool:
    """Whether a SET_POSITION_TARGET_LOCAL_NED asks for no velocity and no turn.

    Args:
        packet: whole, of MAVLink 2, which leaves zeros out at a payload's end.
    """
    payload = packet[_HEADER : _HEADER + packet[1]].ljust(_YAW_RATE + 4, b"\0")
    velocity = struct.unpack_from("<3f", payload, _VELOCITY)
    return not any((*velocity, *struct.unpack_from("<f", payload, _YAW_RATE)))


class MavsdkStream:
    """Sends setpoints through mavsdk, which repeats the last one at 20 Hz until it is stopped.

    Left alone it would go on flying the last velocity while the control loop stands still. So:
    `watch`, called on another thread, sets zero when no setpoint has come for `stall_s` and 0.1 s
    later calls `stop`, which ends the stream and asks for Hold or BRAKE. A pilot who has taken
    over keeps his mode: then the stream ends alone. And `passes`, asked for every packet that
    leaves, lets no setpoint through that the control loop has not renewed in time, even while
    `watch` waits for the processor.

    A plugin that still waits for an answer must not be destroyed: MAVSDK 4.1.0 then calls a
    function that is gone, and the process crashes.

    Args:
        system: mavsdk's.
        clock: runs by itself.
        stall_s: a loop that is silent for so long stands still.
        obeys: whether the vehicle is in the mode that flies setpoints, as far as is known.

    Attributes:
        stalls: how often the control loop stood still.
    """

    def __init__(
        self, system: System, clock: Clock, stall_s: float, obeys: Callable[[], bool]
    ) -> None:
        self._system = system
        self._clock = clock
        self._stall_s = stall_s
        self._obeys = obeys
        self._lock = threading.Lock()
        self._offboard: Offboard | None = None
        self._set_s = float("-inf")
        self._zeroed = False
        self._stopping: list[Offboard] = []
        self.stalls = 0

    @property
    def busy(self) -> bool:
        """Whether a stop still waits for its answer."""
        return bool(self._stopping)

    def set(self, setpoint: VelocitySetpoint, asked_s: float) -> None:
        """Send a setpoint now; the stream goes on with it.

        The hold with which a loop comes back from a stall is not needed, if the vehicle has left
        the mode meanwhile: the last setpoint there was zero.

        Args:
            setpoint: m/s and rad/s in the heading frame.
            asked_s: since when, in seconds.
        """
        with self._lock:
            stalled, self._zeroed = self._zeroed, False
            self._set_s = asked_s
            if not (stalled and setpoint == HOLD and not self._obeys()):
                self._put(setpoint)

    def end(self) -> None:
        """End the stream; the vehicle's mode stays."""
        with self._lock:
            self._destroy()

    def watch(self) -> None:
        """Bring the vehicle to rest if the control loop stands still."""
        with self._lock:
            silent_s = self._clock.now() - self._set_s
            if self._offboard is None or silent_s <= self._stall_s:
                return
            if not self._zeroed:
                self.stalls += 1
                self._zeroed = True
                self._put(HOLD)
            elif silent_s > self._stall_s + _STOP_AFTER_S:
                self._stop(self._offboard)

    def passes(self, packet: bytes) -> bool:
        """Whether a packet of mavsdk's may leave."""
        if message_id_of(packet) != mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            return True
        if self._offboard is None:
            return False
        if self._zeroed:
            # mavsdk's own thread may have made one of the old velocity just before.
            return stands_still(packet)
        return self._clock.now() - self._set_s <= self._stall_s

    def _put(self, setpoint: VelocitySetpoint) -> None:
        if self._offboard is None:
            self._offboard = Offboard(self._system)
        forward, right, down, yaw_rate = setpoint.values
        velocity = VelocityBodyYawspeed(forward, right, down, math.degrees(yaw_rate))
        # What it cannot send now is a lost packet, as with the other link.
        with contextlib.suppress(OffboardError):
            self._offboard.set_velocity_body(velocity)

    def _stop(self, offboard: Offboard) -> None:
        if not self._obeys():
            self._destroy()
            return
        self._offboard = None
        self._stopping.append(offboard)
        offboard.stop_async(lambda _result, _data: self._stopping.remove(offboard))

    def _destroy(self) -> None:
        offboard, self._offboard = self._offboard, None
        if offboard is not None:
            offboard.destroy()


class MavsdkLink(Link):
    """A link whose setpoints, heartbeats and messages to the autopilot go through MAVSDK.

    The bytes stay ours: MAVSDK's raw connection hands them over, so that connection strings,
    signing, the recording, telemetry and the count of what is refused are the same as for the
    other link. MAVSDK sees packets of our vehicle's autopilot alone. A thread carries them in and
    watches the stream. See `Link`.

    Args:
        transport: carries the bytes; closed with the link; `send` is called from other threads.
        settings: see there.
        signer: signs and checks, if the link is signed.
        clock: runs by itself: there is no lockstep with MAVSDK.
    """

    kind = "mavsdk"

    def __init__(
        self,
        transport: Transport,
        settings: LinkSettings | None,
        signer: Signer | None,
        clock: Clock,
    ) -> None:
        super().__init__(transport, settings, signer)
        self._system_clock = clock
        self._mavsdk: Mavsdk | None = None
        self._direct: MavlinkDirect | None = None
        self._stream: MavsdkStream | None = None
        self._sent_since_poll = False
        self._obeys_setpoints = False
        self._stalls = 0
        self._packets: deque[tuple[float, MavlinkPacket]] = deque(maxlen=_MOST_PACKETS)
        self._mode_unpacker = Unpacker()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._can_ask = False
        log_subscribe(_log)

    def poll(self, now_s: float) -> None:
        """Take in what has arrived and send what is due; `now_s` in seconds."""
        if self._stream is not None:
            if not self._sent_since_poll:
                self._stream.end()
            if self._stream.stalls > self._stalls:
                self._stalls = self._stream.stalls
                self._monitor.note("the control loop stood still: zero velocity was sent for it")
        self._sent_since_poll = False
        super().poll(now_s)

    def close(self) -> None:
        """End the stream, close MAVSDK and the transport."""
        if self._stream is not None:
            self._stream.end()
            self._wait_for_stop(self._stream)
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        if self._mavsdk is not None:
            self._mavsdk.destroy()
        super().close()

    def _wait_for_stop(self, stream: MavsdkStream) -> None:
        """Wait until MAVSDK has its answer or has given up; see `MavsdkStream` for why."""
        end_s = self._system_clock.now() + _LONGEST_ANSWER_S
        while stream.busy and self._system_clock.now() < end_s:
            self._system_clock.sleep_until(self._system_clock.now() + _PUMP_S)

    def _receive(self, now_s: float) -> None:
        if self._thread is None:
            self._packets += [(now_s, packet) for packet in self._channel.receive(now_s)]
        self._look_for_system()
        # Before MAVSDK knows the vehicle it can send nothing: there is no telemetry until then.
        while self._packets and (self._vehicle is None or self._direct is not None):
            arrival_s, packet = self._packets.popleft()
            # The other thread goes on meanwhile, and nothing of a step is later than the step.
            self._take(packet, min(arrival_s, now_s))

    def _on_found(self, vehicle: FoundVehicle) -> None:
        super()._on_found(vehicle)
        configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
        configuration.system_id = vehicle.system
        configuration.component_id = COMPONENT_ID
        self._mavsdk = Mavsdk(configuration)
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._send_raw)
        self._mavsdk.add_any_connection("raw://")
        self._sends_heartbeats = False
        self._thread = threading.Thread(target=self._pump, name="mavsdk link", daemon=True)
        self._thread.start()

    def _look_for_system(self) -> None:
        """Take MAVSDK's system as soon as it has received the vehicle's heartbeat."""
        if self._direct is not None or self._mavsdk is None:
            return
        for system in self._mavsdk.get_systems():
            if system.get_system_id() == self.vehicle_id and system.has_autopilot():
                self._direct = MavlinkDirect(system)
                self._can_ask = True
                clock, stall_s = self._system_clock, self._settings.stall_s
                self._stream = MavsdkStream(system, clock, stall_s, lambda: self._obeys_setpoints)
                return

    def _pump(self) -> None:
        """Carry packets to MAVSDK and watch the stream: the thread's work."""
        clock, mavsdk = self._system_clock, self._mavsdk
        while mavsdk is not None and not self._stop.is_set():
            for packet in self._channel.receive(clock.now()):
                self._packets.append((clock.now(), packet))
                if self._is_vehicles(packet) and packet.is_known:
                    self._watch_mode(packet)
                    mavsdk.pass_received_raw_bytes(packet.data)
            if self._stream is not None:
                self._stream.watch()
            clock.sleep_until(clock.now() + _PUMP_S)

    def _watch_mode(self, packet: MavlinkPacket) -> None:
        """Know the mode also while the control loop stands still."""
        if packet.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and self._vehicle is not None:
            beat = self._mode_unpacker.message(packet)
            mode = mode_name(self._vehicle.autopilot, beat.custom_mode)
            self._obeys_setpoints = mode == setpoint_mode(self._vehicle.autopilot)

    def _send_raw(self, packet: bytes) -> None:
        if self._stream is None or self._stream.passes(packet):
            self._channel.send(packet)

    def _send_setpoint(self, setpoint: VelocitySetpoint, vehicle: FoundVehicle) -> None:  # noqa: ARG002
        self._sent_since_poll = True
        if self._stream is not None:
            # It is as old as the step that asked for it, however long that took.
            self._stream.set(setpoint, self._polled_s)

    def _send_fields(self, name: str, fields: dict[str, Any]) -> None:
        # Commands go as messages, too: MAVSDK would wait for the answer to one before it sends
        # another. In JSON null stands for NaN.
        if self._direct is not None and self._vehicle is not None:
            target = self._vehicle.system, AUTOPILOT_ID
            text = json.dumps({key: _json_value(value) for key, value in fields.items()})
            message = MavlinkMessage(name, self._vehicle.system, COMPONENT_ID, *target, text)
            # What it cannot send now is a lost packet, as with the other link.
            with contextlib.suppress(MavlinkDirectError):
                self._direct.send_message(message)


def _json_value(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def _log(level: LogLevel, message: str, _file: str | None, _line: int) -> bool:
    """Keep MAVSDK's own words off the terminal."""
    _LOGGER.log(_LEVELS.get(level, logging.DEBUG), message)
    return True
