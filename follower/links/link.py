"""The companion computer's end of a MAVLink connection to one autopilot."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.clock_sync import AutopilotClock, TimeSync, time_ns
from follower.links.gimbal_manager import GimbalManager
from follower.links.operator_commands import CONSENT_COMMAND, OperatorCommand, OperatorCommands
from follower.links.packet_channel import PacketChannel, PacketPort, SequenceCounter
from follower.links.packet_parser import MavlinkPacket, Unpacker
from follower.links.request_scheduler import ParameterReader, RequestScheduler
from follower.links.signing import Signer
from follower.links.status import LinkStatus
from follower.links.vehicle_finder import FoundVehicle, VehicleFinder, vehicle_of
from follower.links.vehicle_health import HealthMonitor, VehicleHealth
from follower.links.vehicle_monitor import VehicleMonitor, hold_mode, set_mode_params, setpoint_mode
from follower.settings.link import LinkSettings
from follower_control.common.transport import Transport
from follower_control.vehicle.gimbal import GimbalRates
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_control.vehicle.state import ENTRY_S, Attitude, VehicleState

COMPONENT_ID = int(mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
AUTOPILOT_ID = int(mavlink.MAV_COMP_ID_AUTOPILOT1)
_HEARTBEAT_S = 1.0
_SILENCE_S = 3.0
_GIMBALS = (
    mavlink.MAV_COMP_ID_GIMBAL,
    mavlink.MAV_COMP_ID_GIMBAL2,
    mavlink.MAV_COMP_ID_GIMBAL3,
    mavlink.MAV_COMP_ID_GIMBAL4,
    mavlink.MAV_COMP_ID_GIMBAL5,
    mavlink.MAV_COMP_ID_GIMBAL6,
)
_GIMBAL_ATTITUDE = "GIMBAL_DEVICE_ATTITUDE_STATUS"
_COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)


class Link(ABC):
    """A companion computer's end of a link to one vehicle; the base of all links.

    Stepped by `poll`, which never waits and never raises for anything that comes over the link.
    Telemetry that is not finite is dropped, so that it grows stale instead of being believed. A
    new link defines how packets are received, and how setpoints and messages are sent.

    Args:
        transport: carries the bytes; closed with the link.
        settings: message rates in Hz, the vehicle's id, time-outs in seconds.
        signer: signs and checks, if the link is signed.

    Attributes:
        kind: the name by which `link.kind` in the settings chooses it.
        parameters: the autopilot's parameters that were asked for.
    """

    kind: str

    def __init__(
        self,
        transport: Transport,
        settings: LinkSettings | None = None,
        signer: Signer | None = None,
    ) -> None:
        self._settings = settings = settings or LinkSettings()
        self._channel = PacketChannel(transport, signer)
        self._signed = signer is not None
        self._finder = VehicleFinder(settings.vehicle_id, settings.listen_s)
        self._codec = mavlink.MAVLink(None, settings.vehicle_id or 1, COMPONENT_ID)
        self._clock = AutopilotClock()
        self._timesync = TimeSync(self._clock, settings.timesync_rate_hz)
        self._requests = RequestScheduler(settings, self._command)
        self._operators = OperatorCommands()
        self._sequence = SequenceCounter()
        self._unpacker = Unpacker()
        self._gimbal_device: int | None = None
        self._gimbal_number = 0
        self._gimbal: GimbalManager | None = None
        self._vehicle: FoundVehicle | None = None
        self._monitor = VehicleMonitor(self._clock)
        self._health = HealthMonitor()
        self.parameters = ParameterReader()
        self._polled_s = self._sent_s = self._heartbeat_sent_s = -math.inf
        self._told: set[str] = set()
        self._sends_heartbeats = True  # and not a library
        self._can_ask = True  # whether messages would reach the vehicle already

    @property
    def state(self) -> VehicleState:
        """The newest telemetry: positions in m and velocities in m/s (NED), angles in rad."""
        return self._monitor.state

    @property
    def attitudes(self) -> Sequence[Attitude]:
        """The attitudes (rad, body to NED) that came with the last `poll`, oldest first."""
        return self._monitor.attitudes

    @property
    def altitude_msl_m(self) -> float | None:
        """Height above mean sea level in metres, None before it is known."""
        return self._monitor.altitude_msl_m

    @property
    def connected(self) -> bool:
        """Whether it is clear which vehicle is ours."""
        return self._vehicle is not None

    @property
    def autopilot_name(self) -> str:
        """What kind of autopilot answers: "px4", "ardupilot", or "unknown" before it does."""
        return "unknown" if self._vehicle is None else self._vehicle.autopilot_name

    @property
    def health(self) -> VehicleHealth:
        """What the vehicle reported about its health; little before `watch_health`."""
        return self._health.health

    @property
    def vehicle_id(self) -> int | None:
        """The vehicle's MAVLink system id, None before it is found."""
        return None if self._vehicle is None else self._vehicle.system

    def open_port(self, message_ids: frozenset[int]) -> PacketPort:
        """Return a port for another component on this link; there is one at a time.

        Args:
            message_ids: of the packets it receives, from whomever they come.
        """
        port = PacketPort(message_ids, self._channel.send)
        self._channel.tap = port.receive
        return port

    def watch_health(self) -> None:
        """From now on request the firmware's version and, once a second, the vehicle's health."""
        self._requests.watch_health(self._vehicle)

    def use_gimbal(self, device: int) -> None:
        """From now on find the gimbal, take its control and request its attitude."""
        self._gimbal_device = self._gimbal_number = device
        self._requests.watch_gimbal()

    def turn_gimbal(self, rates: GimbalRates) -> None:
        """Turn the gimbal at rates in rad/s, if there is one and nobody else controls it."""
        if self._gimbal is not None and self._vehicle is not None and self._gimbal.obeys_us:
            self._send_message(self._gimbal.rates_message(rates, self._vehicle.system))

    def status(self, now_s: float) -> LinkStatus:
        """Return how well the link works; `now_s` in seconds on the system's clock."""
        return LinkStatus(
            kind=self.kind,
            vehicle_id=self.vehicle_id,
            autopilot=self.autopilot_name,
            problem="" if self.connected else self._finder.problem(now_s),
            round_trip_s=self._timesync.round_trip_s,
            clock_error_s=self._clock.error_s,
            clock_pace=self._clock.pace,
            clock_restarts=self._clock.restarts,
            rates=self._requests.rates.measured(now_s) if self.connected else (),
            received=self._channel.received,
            of_vehicle=self._sequence.came,
            lost=self._sequence.lost,
            refused=dict(self._channel.refused),
            skipped_bytes=self._channel.skipped_bytes,
            signed=self._signed,
        )

    def poll(self, now_s: float) -> None:
        """Take in what has arrived and send what is due; `now_s` in seconds.

        Where no setpoint is sent between two polls, the stream of setpoints has ended.
        """
        self._polled_s = now_s
        self._monitor.begin()
        self._receive(now_s)
        self._monitor.settle()
        if self._sends_heartbeats and now_s - self._heartbeat_sent_s >= _HEARTBEAT_S:
            self._heartbeat_sent_s = now_s
            self._send_heartbeat()
        if self._vehicle is not None and self._can_ask:
            self._ask(now_s)

    def take_notes(self) -> list[str]:
        """Return the autopilot's texts, refusals and the link's own troubles since last time."""
        return self._monitor.take_notes()

    def send(self, setpoint: VelocitySetpoint) -> None:
        """Send one velocity setpoint (m/s and rad/s, heading frame), once the vehicle is found.

        Raises:
            ValueError: a number is not finite. The envelope never lets that come so far.
        """
        if not setpoint.is_finite:
            raise ValueError(f"a setpoint that is not finite never leaves: {setpoint}")
        if self._vehicle is not None:
            self._sent_s = self._polled_s
            self._send_setpoint(setpoint, self._vehicle)

    def take_commands(self) -> Sequence[OperatorCommand]:
        """Return the commands addressed to us since last time."""
        return self._operators.take()

    def answer(self, command: OperatorCommand, accepted: bool) -> None:
        """Acknowledge a command to us; what is no consent is not supported."""
        result = mavlink.MAV_RESULT_ACCEPTED if accepted else mavlink.MAV_RESULT_DENIED
        if command.command != CONSENT_COMMAND:
            result = mavlink.MAV_RESULT_UNSUPPORTED
        target = command.system, command.component
        message = mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, *target)
        self._send_message(message)

    def arm(self) -> None:
        """Ask the autopilot to arm."""
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def take_off(self, height_m: float) -> None:
        """Ask for a take-off to `height_m`, metres above the ground the vehicle stands on."""
        # PX4 takes an altitude above mean sea level, ArduCopter one above home.
        if self.autopilot_name != "px4":
            # Of NaN as a place older ArduPilot SITLs die by a floating point exception.
            self._command(mavlink.MAV_CMD_NAV_TAKEOFF, *(0.0,) * 6, height_m)
            return
        nan = math.nan
        above = nan if self.altitude_msl_m is None else self.altitude_msl_m + height_m
        self._command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, nan, nan, nan, above)

    def enter_mode(self, name: str) -> None:
        """Ask for a mode by the autopilot's own name.

        Raises:
            ValueError: the autopilot has no mode of that name.
        """
        if self._vehicle is not None:
            params = set_mode_params(self._vehicle.autopilot, name)
            self._command(mavlink.MAV_CMD_DO_SET_MODE, *params)

    def enter_setpoint_mode(self) -> None:
        """Ask for OFFBOARD or GUIDED."""
        if self._vehicle is not None:
            self.enter_mode(setpoint_mode(self._vehicle.autopilot))

    def enter_hold_mode(self) -> None:
        """Ask for the mode in which the autopilot stands still by itself."""
        if self._vehicle is not None:
            self.enter_mode(hold_mode(self._vehicle.autopilot_name))

    def close(self) -> None:
        """End the stream and close the transport."""
        self._channel.close()

    @abstractmethod
    def _receive(self, now_s: float) -> None:
        """Hand every packet that has come to `_take`."""

    @abstractmethod
    def _send_setpoint(self, setpoint: VelocitySetpoint, vehicle: FoundVehicle) -> None:
        """Send a finite setpoint, m/s and rad/s in the heading frame."""

    @abstractmethod
    def _send_fields(self, name: str, fields: dict[str, Any]) -> None:
        """Send a message by its MAVLink name and fields."""

    def _on_found(self, vehicle: FoundVehicle) -> None:
        """Begin to talk to the vehicle."""
        self._vehicle = vehicle
        self._codec.srcSystem = vehicle.system
        self._monitor.autopilot = vehicle.autopilot
        self.parameters.bytewise = vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4
        if self._gimbal_device is not None:
            self._gimbal = GimbalManager(vehicle.system, COMPONENT_ID, self._gimbal_device)
        self._requests.begin(vehicle)

    def _is_vehicles(self, packet: MavlinkPacket) -> bool:
        """Whether our vehicle's autopilot sent it; another program may beat by the same numbers."""
        if not self._has_its_numbers(packet):
            return False
        if packet.message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return True
        return self._beats(packet) == self._vehicle

    def _has_its_numbers(self, packet: MavlinkPacket) -> bool:
        return packet.system == self.vehicle_id and packet.component == AUTOPILOT_ID

    def _beats(self, packet: MavlinkPacket) -> FoundVehicle | None:
        """Return the vehicle of which it is a heartbeat, None if of no vehicle."""
        beat = self._unpacker.message(packet)
        return vehicle_of(packet.system, packet.component, beat.type, beat.autopilot)

    def _take(self, packet: MavlinkPacket, now_s: float) -> None:
        """Take a packet that arrived at `now_s`, in seconds."""
        if not self._is_vehicles(packet):
            self._take_others(packet, now_s)
            return
        self._sequence.count(packet.sequence)
        if packet.is_known:
            self._take_vehicles(self._unpacker.message(packet), now_s)

    def _take_vehicles(self, message: Any, now_s: float) -> None:
        """Take a message of the vehicle's autopilot."""
        name = message.get_type()
        if name == "HEARTBEAT" and self.state.heartbeat_age_s(now_s) > _SILENCE_S:
            self._requests.rates.ask_anew()
        self._requests.rates.count(name, now_s)
        if name == "TIMESYNC":
            self._on_timesync(message, now_s)
        elif name == "PARAM_VALUE":
            self.parameters.take(message.param_id, message.param_value, message.param_type)
        elif name == _GIMBAL_ATTITUDE and not self._is_our_gimbal(message.gimbal_device_id):
            return
        elif self._gimbal is None or not self._gimbal.take(name, message):
            self._health.take(name, message, now_s)
            self._monitor.take(name, message, now_s)

    def _take_others(self, packet: MavlinkPacket, now_s: float) -> None:
        """Take a packet that is not, or not yet, known to be the vehicle's autopilot's."""
        if packet.message_id in _COMMANDS:
            self._take_command(packet, now_s)
        elif packet.message_id == mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS:
            self._take_gimbal(packet, now_s)
        elif packet.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self._take_heartbeat(packet, now_s)

    def _take_command(self, packet: MavlinkPacket, now_s: float) -> None:
        message = self._codec.decode(bytearray(packet.data))
        target = message.target_system, message.target_component
        if self._vehicle is not None and target == (self._vehicle.system, COMPONENT_ID):
            self._operators.receive(message, now_s)

    def _take_gimbal(self, packet: MavlinkPacket, now_s: float) -> None:
        """Take the attitude of a gimbal with a component number, and a clock, of its own."""
        gimbals = packet.system == self.vehicle_id and packet.component in _GIMBALS
        wanted = gimbals and self._gimbal_device is not None
        if wanted and self._is_our_gimbal(packet.component):
            self._requests.rates.count(_GIMBAL_ATTITUDE, now_s)
            self._monitor.take_gimbal(self._unpacker.message(packet), now_s)

    def _is_our_gimbal(self, number: int) -> bool:
        """Whether it is the gimbal that is wanted; where any is, the first one heard of.

        Its number is its component's, or from 1 to 6 if it is the autopilot's own; 0 is not told.
        """
        if self._gimbal_number == 0:
            self._gimbal_number = number
        return number in (0, self._gimbal_number)

    def _take_heartbeat(self, packet: MavlinkPacket, now_s: float) -> None:
        """Take the heartbeat of somebody who is not, or not yet, our vehicle."""
        vehicle = self._beats(packet)
        if vehicle is not None:
            self._finder.take(vehicle, now_s)
        if self._vehicle is not None:
            self._note_another(packet, vehicle)
            return
        found = self._finder.found(now_s)
        if found is not None:
            self._on_found(found)
            if self._is_vehicles(packet):
                self._take_vehicles(self._unpacker.message(packet), now_s)

    def _note_another(self, packet: MavlinkPacket, vehicle: FoundVehicle | None) -> None:
        """Note once who else beats as a vehicle, or by our vehicle's numbers."""
        if vehicle is not None:
            who = f"another vehicle, system {vehicle.system},"
        elif self._has_its_numbers(packet):
            who = f"another program with the autopilot's numbers, {packet.system}/{AUTOPILOT_ID},"
        else:
            return
        if who not in self._told:
            self._told.add(who)
            self._monitor.note(f"{who} sends heartbeats and is ignored")

    def _on_timesync(self, message: Any, now_s: float) -> None:
        if message.tc1 == 0:
            self._send_timesync(time_ns(now_s), message.ts1)
        elif self._timesync.answer(message.tc1, message.ts1, now_s):
            self._monitor.note_answer(now_s)

    def _ask(self, now_s: float) -> None:
        """Send what is due of questions and requests."""
        stamp = self._timesync.question(now_s)
        if stamp is not None:
            self._send_timesync(0, stamp)
        steered = self.state.obeys_setpoints or now_s - self._sent_s < ENTRY_S
        has_firmware = self._health.health.firmware is not None
        for note in self._requests.ask(now_s, steered, has_firmware):
            self._monitor.note(note)
        for name in self.parameters.due(now_s):
            self._send_to_autopilot("PARAM_REQUEST_READ", param_id=name, param_index=-1)
        if self._gimbal is not None:
            for command, params in self._gimbal.due(now_s):
                self._command(command, *params)

    def _command(self, command: int, *params: float) -> None:
        """Send a command to the autopilot, with its first parameters."""
        padded = params + (0.0,) * (7 - len(params))
        named = {f"param{number}": value for number, value in enumerate(padded, 1)}
        self._send_to_autopilot("COMMAND_LONG", command=command, confirmation=0, **named)

    def _send_to_autopilot(self, name: str, **fields: Any) -> None:
        if self._vehicle is not None:
            target = {"target_system": self._vehicle.system, "target_component": AUTOPILOT_ID}
            self._send_fields(name, {**target, **fields})

    def _send_timesync(self, tc1: int, ts1: int) -> None:
        self._send_fields("TIMESYNC", {"tc1": tc1, "ts1": ts1})

    def _send_heartbeat(self) -> None:
        # As a ground station's it would hide the loss of the real one.
        kind, state = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_STATE_ACTIVE
        autopilot = mavlink.MAV_AUTOPILOT_INVALID
        self._send_message(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, state, 3))

    def _send_message(self, message: Any) -> None:
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        self._channel.send(data)
