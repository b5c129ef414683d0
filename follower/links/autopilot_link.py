"""What all links have in common: finding the vehicle, its state, rates and clocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.links.autopilot_clock import AutopilotClock
from follower.links.channel import PacketChannel
from follower.links.gimbal_manager import GimbalManager
from follower.links.health_monitor import HealthMonitor
from follower.links.link_settings import LinkSettings
from follower.links.link_status import LinkStatus
from follower.links.modes import hold_mode, set_mode_params, setpoint_mode
from follower.links.operator_commands import OperatorCommand, OperatorCommands
from follower.links.packet_port import PacketPort
from follower.links.packets import Packet
from follower.links.parameter_reader import ParameterReader
from follower.links.questions import Questions, Voice
from follower.links.sequence import SequenceCounter
from follower.links.signing import Signer
from follower.links.timesync import TimeSync, time_ns
from follower.links.unpacking import Unpacker
from follower.links.vehicle_finder import Vehicle, VehicleFinder
from follower.links.vehicle_health import VehicleHealth
from follower.links.vehicle_monitor import VehicleMonitor
from follower_control.gimbal import GimbalRates
from follower_control.setpoint import VelocitySetpoint
from follower_control.transport import Transport
from follower_control.vehicle import ENTRY_S, Attitude, VehicleState

COMPONENT_ID = int(mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
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
_COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)


class AutopilotLink(ABC):
    """The base of both links; see `Link` for what they promise.

    Args:
        transport: carries the bytes; closed with the link.
        settings: see there.
        signer: signs and checks, if the link is signed.
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
        voice = Voice(
            self._command, self._request, self._send_parameter_request, self._send_timesync
        )
        self._questions = Questions(settings, self._timesync, voice)
        self._rates = self._questions.rates
        self._operators = OperatorCommands()
        self._sequence = SequenceCounter()
        self._unpacker = Unpacker()
        self._gimbal_device: int | None = None
        self._gimbal: GimbalManager | None = None
        self._vehicle: Vehicle | None = None
        self._monitor: VehicleMonitor | None = None
        self._health: HealthMonitor | None = None
        self._polled_s = self._sent_s = self._heartbeat_sent_s = float("-inf")
        self._others: set[int] = set()

    @property
    def state(self) -> VehicleState:
        """The newest of everything that the vehicle told."""
        return VehicleState() if self._monitor is None else self._monitor.state

    @property
    def attitudes(self) -> Sequence[Attitude]:
        """The attitudes that came with the last `poll`, oldest first."""
        return () if self._monitor is None else self._monitor.attitudes

    @property
    def altitude_msl_m(self) -> float | None:
        """Height above mean sea level, None before it is known."""
        return None if self._monitor is None else self._monitor.altitude_msl_m

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
        """What the vehicle said about its health; little before `watch_health`."""
        return VehicleHealth() if self._health is None else self._health.health

    @property
    def parameters(self) -> ParameterReader | None:
        """The parameters asked for, None before the vehicle is found."""
        return None if self._health is None else self._health.parameters

    @property
    def vehicle_id(self) -> int | None:
        """The vehicle's MAVLink system id, None before it is found."""
        return None if self._vehicle is None else self._vehicle.system

    def open_port(self, message_ids: frozenset[int]) -> PacketPort:
        """Return a port for another component on this link; there is one at a time.

        Args:
            message_ids: of what it is to hear, from whomever it comes.
        """
        port = PacketPort(message_ids, self._channel.send)
        self._channel.tap = port.hear
        return port

    def watch_health(self) -> None:
        """From now on have the vehicle tell its firmware and, once a second, its health."""
        self._questions.watch_health(self._vehicle)

    def use_gimbal(self, device: int) -> None:
        """From now on find the gimbal, take its control and have its attitude told."""
        self._gimbal_device = device
        self._questions.watch_gimbal()

    def turn_gimbal(self, rates: GimbalRates) -> None:
        """Turn the gimbal, if there is one and nobody else controls it."""
        if self._gimbal is not None and self._vehicle is not None and self._gimbal.obeys_us:
            self._send_message(self._gimbal.rates_message(rates, self._vehicle.system))

    def read_parameters(self, names: Iterable[str]) -> None:
        """Have these parameters read, once the vehicle is found."""
        if self._health is not None:
            self._health.parameters.want(names)

    def status(self, now_s: float) -> LinkStatus:
        """Return how well the link works."""
        return LinkStatus(
            kind=self.kind,
            vehicle_id=None if self._vehicle is None else self._vehicle.system,
            autopilot=self.autopilot_name,
            problem="" if self.connected else self._finder.problem(now_s),
            round_trip_s=self._timesync.round_trip_s,
            clock_error_s=self._clock.error_s,
            clock_restarts=self._clock.restarts,
            rates=self._rates.measured(now_s) if self.connected else (),
            received=self._channel.received,
            lost=self._sequence.lost,
            refused=dict(self._channel.refused),
            skipped_bytes=self._channel.skipped_bytes,
            signed=self._signed,
        )

    def poll(self, now_s: float) -> None:
        """Take in what has arrived and send what is due."""
        self._polled_s = now_s
        if self._monitor is not None:
            self._monitor.begin()
        self._receive(now_s)
        if self._monitor is not None:
            self._monitor.settle()
        if self._sends_heartbeats and now_s - self._heartbeat_sent_s >= _HEARTBEAT_S:
            self._heartbeat_sent_s = now_s
            self._send_heartbeat()
        if self._vehicle is not None and self._can_ask:
            steered = self.state.obeys_setpoints or now_s - self._sent_s < ENTRY_S
            for text in self._questions.ask(now_s, steered, self._health, self._gimbal):
                self._note(text)

    def take_notes(self) -> list[str]:
        """Return the autopilot's texts, refusals and the link's own troubles since last time."""
        return [] if self._monitor is None else self._monitor.take_notes()

    def send(self, setpoint: VelocitySetpoint) -> None:
        """Send one velocity setpoint; nothing is sent before the vehicle is found.

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
        """Acknowledge a command to us."""
        result = mavlink.MAV_RESULT_ACCEPTED if accepted else mavlink.MAV_RESULT_DENIED
        target = command.system, command.component
        message = mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, *target)
        self._send_message(message)

    def enter_mode(self, name: str) -> None:
        """Ask for a mode by the autopilot's own name.

        Raises:
            ValueError: the autopilot has no mode of that name.
        """
        self._set_mode(name)

    def enter_setpoint_mode(self) -> None:
        """Ask for OFFBOARD or GUIDED."""
        if self._vehicle is not None:
            self._set_mode(setpoint_mode(self._vehicle.autopilot))

    def enter_hold_mode(self) -> None:
        """Ask for the mode in which the autopilot stands still by itself."""
        if self._vehicle is not None:
            self._set_mode(hold_mode(self._vehicle.autopilot))

    @abstractmethod
    def arm(self) -> None:
        """Ask the autopilot to arm."""

    @abstractmethod
    def take_off(self, height_m: float) -> None:
        """Ask for a take-off to `height_m` above the ground the vehicle stands on."""

    def close(self) -> None:
        """End the stream and close the transport."""
        self._channel.close()

    @property
    def _sends_heartbeats(self) -> bool:
        """Whether heartbeats are ours to send, and not a library's."""
        return True

    @property
    def _can_ask(self) -> bool:
        """Whether commands would reach the vehicle already."""
        return True

    @abstractmethod
    def _receive(self, now_s: float) -> None:
        """Hand every message that has come to `_take` or `_hear_stranger`."""

    @abstractmethod
    def _send_setpoint(self, setpoint: VelocitySetpoint, vehicle: Vehicle) -> None:
        """Send a finite setpoint."""

    @abstractmethod
    def _command(self, command: int, *params: float) -> None:
        """Send a command to the autopilot."""

    @abstractmethod
    def _send_parameter_request(self, name: str) -> None:
        """Send PARAM_REQUEST_READ."""

    @abstractmethod
    def _send_timesync(self, tc1: int, ts1: int) -> None:
        """Send a TIMESYNC message."""

    def _on_found(self, vehicle: Vehicle) -> None:
        """Begin to talk to the vehicle."""
        self._vehicle = vehicle
        self._codec.srcSystem = vehicle.system
        self._monitor = VehicleMonitor(vehicle, self._clock)
        self._health = HealthMonitor(vehicle)
        if self._gimbal_device is not None:
            self._gimbal = GimbalManager(vehicle.system, COMPONENT_ID, self._gimbal_device)
        self._questions.begin(vehicle)

    def _take_health(self, packet: Packet, now_s: float) -> bool:
        """Take a packet of the vehicle's if it is about health; whether it is nothing else."""
        name = None if self._health is None else self._health.take(packet, now_s)
        if name is None or name == "HEARTBEAT":
            return False
        self._rates.count(name, now_s)
        return True

    def _is_vehicles(self, packet: Packet) -> bool:
        vehicle = self._vehicle
        autopilot = packet.component == mavlink.MAV_COMP_ID_AUTOPILOT1
        return vehicle is not None and packet.system == vehicle.system and autopilot

    def _take(self, name: str, message: Any, now_s: float) -> None:
        """Take a message of the vehicle's autopilot."""
        if self._monitor is None:
            return
        if name == "HEARTBEAT" and self._monitor.state.heartbeat_age_s(now_s) > _SILENCE_S:
            self._rates.ask_anew()
        self._rates.count(name, now_s)
        if self._gimbal is not None and self._gimbal.take(name, message):
            return
        if name == "TIMESYNC":
            self._on_timesync(message, now_s)
        else:
            self._monitor.take(name, message, now_s)

    def _hear_stranger(self, packet: Packet, now_s: float) -> None:
        """Take a packet that is not, or not yet, known to be the vehicle's."""
        if packet.message_id in _COMMANDS:
            self._hear_command(packet, now_s)
        if packet.message_id == mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS:
            self._hear_gimbal(packet, now_s)
        if packet.message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return
        beat = self._codec.decode(bytearray(packet.data))
        self._finder.hear(packet.system, packet.component, beat.type, beat.autopilot, now_s)
        if self._vehicle is not None:
            self._tell_of_another(packet.system, now_s)
            return
        vehicle = self._finder.found(now_s)
        if vehicle is not None:
            self._on_found(vehicle)
            if self._is_vehicles(packet):
                self._take("HEARTBEAT", beat, now_s)

    def _hear_gimbal(self, packet: Packet, now_s: float) -> None:
        """Take the attitude of a gimbal with a component number, and a clock, of its own."""
        if self._vehicle is None or self._monitor is None or self._gimbal_device is None:
            return
        if packet.system == self._vehicle.system and packet.component in _GIMBALS:
            self._rates.count("GIMBAL_DEVICE_ATTITUDE_STATUS", now_s)
            self._monitor.take_gimbal(self._unpacker.message(packet), now_s)

    def _hear_command(self, packet: Packet, now_s: float) -> None:
        message = self._codec.decode(bytearray(packet.data))
        target = message.target_system, message.target_component
        if self._vehicle is not None and target == (self._vehicle.system, COMPONENT_ID):
            self._operators.hear(message, now_s)

    def _tell_of_another(self, system: int, now_s: float) -> None:
        others = {v.system for v in self._finder.vehicles(now_s) if v != self._vehicle}
        if system in others - self._others:
            self._others.add(system)
            self._note(f"another vehicle, system {system}, is heard and not listened to")

    def _note(self, text: str) -> None:
        if self._monitor is not None:
            self._monitor.note(text)

    def _on_timesync(self, message: Any, now_s: float) -> None:
        if message.tc1 == 0:
            self._send_timesync(time_ns(now_s), message.ts1)
        else:
            self._timesync.answer(message.tc1, message.ts1, now_s)
            self._on_answer(now_s)

    def _on_answer(self, now_s: float) -> None:
        if self._monitor is not None:
            self._monitor.hears_us(now_s)

    def _request(self, message_id: int) -> None:
        """Ask for one message, once; nobody waits for an answer."""
        self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, float(message_id))

    def _set_mode(self, name: str) -> None:
        if self._vehicle is not None:
            params = set_mode_params(self._vehicle.autopilot, name)
            self._command(mavlink.MAV_CMD_DO_SET_MODE, *params)

    def _send_heartbeat(self) -> None:
        # As a ground station's it would hide the loss of the real one.
        self._send_message(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                0,
                0,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
        )

    def _send_message(self, message: Any) -> None:
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        self._channel.send(data)
