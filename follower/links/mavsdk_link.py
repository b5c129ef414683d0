"""The mavsdk link: the same vehicle through MAVSDK's own stack."""

from __future__ import annotations

import contextlib
import json
import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from types import SimpleNamespace

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.logging import LogLevel, log_subscribe
from mavsdk.plugins.action import Action, ActionResult
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkDirectResult, MavlinkMessage
from mavsdk.system import System
from pymavlink.dialects.v20 import common as mavlink

from follower.links.autopilot_link import COMPONENT_ID, AutopilotLink
from follower.links.link_settings import LinkSettings
from follower.links.mavsdk_stream import MavsdkStream
from follower.links.modes import mode_name, setpoint_mode
from follower.links.packets import Packet
from follower.links.signing import Signer
from follower.links.vehicle_finder import Vehicle
from follower_control.setpoint import VelocitySetpoint
from follower_control.transport import Transport
from follower_vision.clock import Clock

_PUMP_S = 0.005
_MOST_MESSAGES = 5000
_LONGEST_ANSWER_S = 5.0
_NOT_STATE = ("TIMESYNC", "GIMBAL_MANAGER_INFORMATION", "GIMBAL_MANAGER_STATUS")
_UNANSWERED = ("TIMEOUT", "CONNECTION_ERROR", "NO_SYSTEM")
_LOGGER = logging.getLogger("mavsdk")
_LEVELS = {LogLevel.WARN: logging.INFO, LogLevel.ERROR: logging.WARNING}


class MavsdkLink(AutopilotLink):
    """A link whose commands, heartbeats, telemetry and setpoints go through MAVSDK.

    The bytes stay ours: MAVSDK's raw connection hands them over, so that connection strings,
    signing, the recording and the count of what is refused are the same as for the other link.
    MAVSDK sees packets of our vehicle's autopilot alone. A thread carries them in and watches the
    stream. See `Link`.

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
        self._action: Action | None = None
        self._stream: MavsdkStream | None = None
        self._sent_since_poll = False
        self._obeys_setpoints = False
        self._stalls = 0
        self._messages: deque[tuple[float, MavlinkMessage]] = deque(maxlen=_MOST_MESSAGES)
        self._strangers: deque[Packet] = deque(maxlen=_MOST_MESSAGES)
        self._own: deque[tuple[float, Packet]] = deque(maxlen=_MOST_MESSAGES)
        self._results: deque[str] = deque(maxlen=_MOST_MESSAGES)
        self._waiting: set[object] = set()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        log_subscribe(_log)

    def poll(self, now_s: float) -> None:
        """Take in what has arrived and send what is due."""
        if self._stream is not None and not self._sent_since_poll:
            self._stream.end()
        self._sent_since_poll = False
        super().poll(now_s)
        self._tell_of_stalls()
        while self._results:
            self._note(self._results.popleft())

    def arm(self) -> None:
        """Ask the autopilot to arm."""
        if self._action is not None:
            self._action.arm_async(self._answer_to("arm"))

    def take_off(self, height_m: float) -> None:
        """Ask for a take-off to `height_m` above the ground the vehicle stands on."""
        action = self._action
        if action is not None:
            take_off = partial(self._take_off_with, action)
            action.set_takeoff_altitude_async(
                height_m, self._answer_to("take-off height", take_off)
            )

    def close(self) -> None:
        """End the stream, give MAVSDK back and close the transport."""
        if self._stream is not None:
            self._stream.end()
        self._wait_for_answers()
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        if self._mavsdk is not None:
            self._mavsdk.destroy()
        super().close()

    def _tell_of_stalls(self) -> None:
        stalls = 0 if self._stream is None else self._stream.stalls
        if stalls > self._stalls:
            self._stalls = stalls
            self._note("the control loop stood still: zero velocity was sent for it")

    def _wait_for_answers(self) -> None:
        """Wait until MAVSDK has given up on all commands; see `MavsdkStream` for why."""
        end_s = self._system_clock.now() + _LONGEST_ANSWER_S
        while self._is_waiting and self._system_clock.now() < end_s:
            self._system_clock.sleep_until(self._system_clock.now() + _PUMP_S)

    @property
    def _is_waiting(self) -> bool:
        stopping = self._stream is not None and self._stream.busy
        return stopping or bool(self._waiting)

    @property
    def _sends_heartbeats(self) -> bool:
        return self._mavsdk is None

    @property
    def _can_ask(self) -> bool:
        return self._direct is not None

    def _receive(self, now_s: float) -> None:
        if self._thread is None:
            for packet in self._channel.receive(now_s):
                self._hear_stranger(packet, now_s)
            return
        while self._strangers:
            self._hear_stranger(self._strangers.popleft(), now_s)
        self._look_for_system()
        while self._own:
            came_s, packet = self._own.popleft()
            self._take_health(packet, came_s)
        while self._messages:
            arrival_s, message = self._messages.popleft()
            with contextlib.suppress(json.JSONDecodeError):
                fields = json.loads(message.fields_json)
                self._take(message.message_name, SimpleNamespace(**fields), arrival_s)

    def _on_found(self, vehicle: Vehicle) -> None:
        super()._on_found(vehicle)
        configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
        configuration.system_id = vehicle.system
        configuration.component_id = COMPONENT_ID
        self._mavsdk = Mavsdk(configuration)
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._send_raw)
        self._mavsdk.add_any_connection("raw://")
        self._thread = threading.Thread(target=self._pump, name="mavsdk link", daemon=True)
        self._thread.start()

    def _look_for_system(self) -> None:
        """Take up MAVSDK's system as soon as it has heard the vehicle."""
        if self._direct is not None or self._mavsdk is None or self._vehicle is None:
            return
        for system in self._mavsdk.get_systems():
            if system.get_system_id() == self._vehicle.system and system.has_autopilot():
                self._begin(system)
                return

    def _begin(self, system: System) -> None:
        self._action = Action(system)
        self._direct = direct = MavlinkDirect(system)
        for name in (*_NOT_STATE, *(self._monitor.messages if self._monitor else ())):
            direct.subscribe_message(name, self._on_message)
        stall_s = self._settings.stall_s
        self._stream = MavsdkStream(
            system, self._system_clock, stall_s, lambda: self._obeys_setpoints
        )

    def _pump(self) -> None:
        """Carry packets to MAVSDK and watch the stream: the thread's work."""
        clock, mavsdk = self._system_clock, self._mavsdk
        while mavsdk is not None and not self._stop.is_set():
            for packet in self._channel.receive(clock.now()):
                if self._is_vehicles(packet):
                    self._sequence.count(packet.sequence)
                    if packet.is_known:
                        self._look_at(packet)
                        mavsdk.pass_received_raw_bytes(packet.data)
                else:
                    self._strangers.append(packet)
            if self._stream is not None:
                self._stream.watch()
            clock.sleep_until(clock.now() + _PUMP_S)

    def _look_at(self, packet: Packet) -> None:
        """Keep the mode in view also while the control loop stands still."""
        self._own.append((self._system_clock.now(), packet))
        if packet.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT and self._vehicle is not None:
            beat = mavlink.MAVLink(None).decode(bytearray(packet.data))
            mode = mode_name(self._vehicle.autopilot, beat.custom_mode)
            self._obeys_setpoints = mode == setpoint_mode(self._vehicle.autopilot)

    def _on_message(self, message: MavlinkMessage, _data: object) -> None:
        if message.component_id == mavlink.MAV_COMP_ID_AUTOPILOT1:
            self._messages.append((self._system_clock.now(), message))

    def _send_raw(self, packet: bytes) -> None:
        if self._stream is None or self._stream.passes(packet):
            self._channel.send(packet)

    def _send_setpoint(self, setpoint: VelocitySetpoint, vehicle: Vehicle) -> None:  # noqa: ARG002
        self._sent_since_poll = True
        if self._stream is not None:
            # It is as old as the step that asked for it, however long that took.
            self._stream.set(setpoint, self._polled_s)

    def _command(self, command: int, *params: float) -> None:
        padded = params + (0.0,) * (7 - len(params))
        fields: dict[str, float] = {f"param{i + 1}": value for i, value in enumerate(padded)}
        fields |= {"command": command, "confirmation": 0}
        self._send_direct("COMMAND_LONG", fields)

    def _send_parameter_request(self, name: str) -> None:
        self._send_direct("PARAM_REQUEST_READ", {"param_id": name, "param_index": -1})

    def _request(self, message_id: int) -> None:
        # As a message: MAVSDK would wait for the answer to one command before it sends another.
        fields: dict[str, float] = {f"param{i}": 0.0 for i in range(1, 8)}
        fields |= {"command": mavlink.MAV_CMD_REQUEST_MESSAGE, "confirmation": 0}
        self._send_direct("COMMAND_LONG", fields | {"param1": message_id}, is_awaited=False)

    def _send_timesync(self, tc1: int, ts1: int) -> None:
        self._send_direct("TIMESYNC", {"tc1": tc1, "ts1": ts1})

    def _send_direct(
        self, name: str, fields: Mapping[str, float | str], is_awaited: bool = True
    ) -> None:
        direct, vehicle = self._direct, self._vehicle
        if direct is None or vehicle is None:
            return
        target = (vehicle.system, int(mavlink.MAV_COMP_ID_AUTOPILOT1))
        addressed = {"target_system": target[0], "target_component": target[1], **fields}
        message = MavlinkMessage(name, vehicle.system, COMPONENT_ID, *target, json.dumps(addressed))
        if name == "COMMAND_LONG" and is_awaited:
            direct.send_command_async(message, self._answer_to("a command"))
        else:
            direct.send_message(message)

    def _take_off_with(self, action: Action) -> None:
        action.takeoff_async(self._answer_to("take-off"))

    def _answer_to(self, what: str, then: Callable[[], None] | None = None) -> Callable[..., None]:
        """Return what MAVSDK is to call, on a thread of its own, when a command is answered."""
        token = object()
        self._waiting.add(token)

        def take(result: ActionResult | MavlinkDirectResult, *_: object) -> None:
            # What the autopilot refuses comes as a COMMAND_ACK as well and is noted there.
            if result.name in _UNANSWERED:
                self._results.append(f"{what}: not answered ({result.name})")
            elif then is not None and result.name == "SUCCESS":
                then()
            self._waiting.discard(token)

        return take


def _log(level: LogLevel, message: str, _file: str | None, _line: int) -> bool:
    """Keep MAVSDK's own words off the terminal."""
    _LOGGER.log(_LEVELS.get(level, logging.DEBUG), message)
    return True
