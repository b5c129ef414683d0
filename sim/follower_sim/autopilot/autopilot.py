"""A simulated autopilot: physics, rules and MAVLink, stepped by whoever owns the time."""

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower_control.common.transport import Transport
from follower_sim.autopilot.arducopter import ArduCopterController
from follower_sim.autopilot.firmware import ARDUCOPTER, PX4
from follower_sim.autopilot.flight_controller import FlightController, PositionTarget
from follower_sim.autopilot.gimbal_protocol import GimbalProtocol
from follower_sim.autopilot.mavlink_endpoint import Faults, MavlinkEndpoint
from follower_sim.autopilot.parameters import ParameterProtocol
from follower_sim.autopilot.px4 import Px4Controller
from follower_sim.autopilot.telemetry import Health, Telemetry
from follower_sim.kinematics import BodyState
from follower_sim.vehicle.gimbal import Gimbal
from follower_sim.vehicle.response import Drag
from follower_sim.vehicle.vehicle import STEP_S, SimulatedVehicle, WindField
from follower_vision.clock import Clock

_FORCE = 21196.0
_ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
_UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED

Params = Sequence[float]

SYSTEM_ID, COMPONENT_ID = 1, 1
_BOOTED_BEFORE_S = 20.0
_SLACK_S = 1e-9


class Commands:
    """Carries out COMMAND_LONG and COMMAND_INT."""

    def __init__(
        self, controller: FlightController, telemetry: Telemetry, send: Callable[[Any], None]
    ) -> None:
        self._controller = controller
        self._telemetry = telemetry
        self._send = send
        px4 = controller.firmware.name == "px4"
        self._refused = (
            mavlink.MAV_RESULT_TEMPORARILY_REJECTED if px4 else mavlink.MAV_RESULT_FAILED
        )
        self._handlers: dict[int, Callable[[Params], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: lambda p: self._result(controller.take_off(p[6])),
            mavlink.MAV_CMD_NAV_LAND: lambda _: self._enter("LAND"),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: self._enter("RTL"),
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: lambda p: self._request(_whole(p[0])),
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda _: self._request(
                mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
            ),
        }

    def run(self, command: int, params: Params) -> int:
        """Carry out a command with its seven parameters; return the MAV_RESULT."""
        handler = self._handlers.get(command)
        return int(_UNSUPPORTED if handler is None else handler(params))

    def set_mode(self, custom_mode: int) -> int:
        """Change to the mode with this number; return the MAV_RESULT."""
        mode = self._controller.firmware.mode_of(custom_mode)
        return self._result(mode is not None and self._controller.set_mode(mode))

    def _result(self, accepted: bool) -> int:
        return int(_ACCEPTED if accepted else self._refused)

    def _enter(self, name: str) -> int:
        return self._result(self._controller.set_mode(self._controller.firmware.modes[name]))

    def _arm_disarm(self, params: Params) -> int:
        force = params[1] == _FORCE
        act = self._controller.arm if params[0] == 1.0 else self._controller.disarm
        return self._result(act(force))

    def _do_set_mode(self, params: Params) -> int:
        base, main, sub = (_whole(p) for p in params[:3])
        if not base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return int(_UNSUPPORTED)
        if self._controller.firmware.name == "px4":
            return self.set_mode((main & 0xFF) << 16 | (sub & 0xFF) << 24)
        return self.set_mode(main)

    def _set_message_interval(self, params: Params) -> int:
        known = self._telemetry.set_interval(_whole(params[0]), params[1])
        return int(_ACCEPTED if known else mavlink.MAV_RESULT_FAILED)

    def _request(self, message_id: int) -> int:
        message = self._telemetry.on_request(message_id)
        if message is None:
            return int(_UNSUPPORTED)
        self._send(message)
        return int(_ACCEPTED)


def _whole(number: float) -> int:
    """Return the integer that a float parameter carries, -1 if it carries none."""
    return int(number) if math.isfinite(number) else -1


class SimAutopilot:
    """A quadrotor with PX4 or ArduCopter, as seen through its MAVLink port.

    Knows no threads, sockets and clocks: `step` brings it to a time. With the same bytes at the
    same times it answers with the same bytes.

    Args:
        flavour: "px4" or "ardupilot".
        transport: carries MAVLink to and from the companion.
        start: where it stands at the start and when; in the air it is armed and holds its place.
        wind: the air's velocity at a time; None is still air.
        gimbal: hangs below it, if given.
        drag: of its airframe; None is that of the recorded one.

    Attributes:
        faults: switches for what goes wrong.
        health: what it reports of its sensors, battery, GPS and estimator.
        gimbal: the one given.
        on_step: is called at the end of each `step`, if given.

    Raises:
        ValueError: there is no such flavour.
    """

    def __init__(
        self,
        flavour: str,
        transport: Transport,
        start: BodyState,
        wind: WindField | None = None,
        gimbal: Gimbal | None = None,
        drag: Drag | None = None,
    ) -> None:
        self.faults = Faults()
        self.health = Health()
        self.on_step: Callable[[float], None] | None = None
        self._controller = _controller(flavour, start, wind, drag)
        self._start_s = start.time_s
        self._steps = 0
        self._now_s = start.time_s
        self._boot_s = start.time_s - _BOOTED_BEFORE_S
        self._noise = np.random.default_rng(0).spawn(1)[0]
        self.gimbal = gimbal
        self._gimbal = None if gimbal is None else GimbalProtocol(gimbal)
        self._telemetry = self._make_telemetry()
        self._link = MavlinkEndpoint(transport, SYSTEM_ID, COMPONENT_ID, self.faults)
        self._commands = Commands(self._controller, self._telemetry, self._link.send)
        parameters = ParameterProtocol(
            self._controller.parameters, flavour == PX4.name, self._link.send
        )
        self._handlers: dict[str, Callable[[Any], None]] = {
            "SET_POSITION_TARGET_LOCAL_NED": self._on_position_target,
            "COMMAND_LONG": self._on_command_long,
            "COMMAND_INT": self._on_command_int,
            "SET_MODE": self._on_set_mode,
            "PARAM_REQUEST_READ": parameters.read,
            "PARAM_REQUEST_LIST": parameters.list,
            "PARAM_SET": parameters.set,
            "TIMESYNC": self._on_timesync,
        }
        if self._gimbal is not None:
            self._handlers["GIMBAL_MANAGER_SET_ATTITUDE"] = self._gimbal.take

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters by name; a new value counts at once."""
        return self._controller.parameters

    @property
    def state(self) -> BodyState:
        """The truth at the last step."""
        return self._controller.vehicle.state

    @property
    def mode(self) -> str:
        """The flight mode by the autopilot's own name, e.g. "OFFBOARD", "GUIDED", "LOITER"."""
        return self._controller.mode.name

    @property
    def armed(self) -> bool:
        """Whether the motors turn."""
        return self._controller.armed

    @property
    def landed(self) -> bool:
        """Whether it stands on the ground."""
        return self._controller.landed

    def state_at(self, time_s: float) -> BodyState:
        """Return the truth at a time of the last two seconds, interpolated."""
        return self._controller.vehicle.state_at(time_s)

    def switch_mode(self, name: str) -> bool:
        """Turn the pilot's mode switch; whether the autopilot follows.

        Raises:
            ValueError: it has no mode of that name.
        """
        modes = self._controller.firmware.modes
        if name not in modes:
            raise ValueError(f"no mode {name!r}; there are {', '.join(modes)}")
        return self._controller.set_mode(modes[name])

    def move_sticks(self, *pulses_us: int) -> None:
        """Have the pilot's receiver give these pulses, channel by channel; none takes it away."""
        self._controller.pulses_us = pulses_us

    def move_home(self, north_m: float, east_m: float, down_m: float) -> None:
        """Set home, metres in the world, as arming there does; positions count on as before."""
        self._controller.home_m = north_m, east_m, down_m

    def restart(self) -> None:
        """Begin anew as after a loss of power: the clock, the rates and the mode.

        It stays in the air: what a real vehicle does meanwhile is not simulated.
        """
        controller = self._controller
        self._boot_s = self._now_s
        self._telemetry = self._make_telemetry()
        self._commands = Commands(controller, self._telemetry, self._link.send)
        controller.set_mode(controller.firmware.modes[controller.firmware.hold_mode])

    def step(self, now_s: float) -> None:
        """Receive what has arrived, fly up to `now_s` and send what is due on the way."""
        self._now_s = now_s
        self._controller.refuses_setpoints = self.faults.refuses_setpoints
        self._controller.refused_modes = self.faults.refused_modes
        self._controller.arms_from_s = max(self.health.settled_s, self.health.fit_s)
        for message in self._link.receive():
            self._handle(message)
        self._send_texts()
        while self._start_s + (self._steps + 1) * STEP_S <= now_s + _SLACK_S:
            self._steps += 1
            self._controller.step()
            if self.gimbal is not None:
                now, yaw = self._controller.now_s, self.state.yaw_rad
                self.gimbal.step(now, STEP_S, yaw)
            for message in self._telemetry.due():
                self._link.send(message)
            self._send_texts()
        if self.on_step is not None:
            self.on_step(now_s)

    def _make_telemetry(self) -> Telemetry:
        return Telemetry(
            self._controller, self.faults, self.health, self._boot_s, self._noise, self._gimbal
        )

    def _handle(self, message: Any) -> None:
        handler = self._handlers.get(message.get_type())
        if handler is not None and _is_for_us(message):
            handler(message)

    def _send_texts(self) -> None:
        texts = self._controller.texts
        while texts:
            severity, text = texts.pop(0)
            self._link.send(mavlink.MAVLink_statustext_message(severity, text.encode()[:50]))

    def _on_position_target(self, m: Any) -> None:
        self._controller.take_setpoint(
            PositionTarget(
                m.coordinate_frame,
                m.type_mask,
                (m.x, m.y, m.z),
                (m.vx, m.vy, m.vz),
                m.yaw,
                m.yaw_rate,
            )
        )

    def _on_command_long(self, m: Any) -> None:
        params = [getattr(m, f"param{number}") for number in range(1, 8)]
        self._acknowledge(m, self._run(m, params))

    def _on_command_int(self, m: Any) -> None:
        params = [m.param1, m.param2, m.param3, m.param4, float(m.x), float(m.y), m.z]
        self._acknowledge(m, self._run(m, params))

    def _run(self, m: Any, params: list[float]) -> int:
        if self._gimbal is not None and m.command == mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            return self._gimbal.configure(params, (m.get_srcSystem(), m.get_srcComponent()))
        return self._commands.run(m.command, params)

    def _acknowledge(self, m: Any, result: int) -> None:
        self._link.send(
            mavlink.MAVLink_command_ack_message(
                m.command, result, 0, 0, m.get_srcSystem(), m.get_srcComponent()
            )
        )

    def _on_set_mode(self, m: Any) -> None:
        if m.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self._commands.set_mode(m.custom_mode)

    def _on_timesync(self, m: Any) -> None:
        if m.tc1 == 0:
            boot_ns = round(self._telemetry.since_boot_s(self._now_s) * 1e9)
            self._link.send(mavlink.MAVLink_timesync_message(boot_ns, m.ts1))


def _controller(
    flavour: str, start: BodyState, wind: WindField | None, drag: Drag | None
) -> FlightController:
    for firmware, controller in ((PX4, Px4Controller), (ARDUCOPTER, ArduCopterController)):
        if flavour == firmware.name:
            response = firmware.response if drag is None else replace(firmware.response, drag=drag)
            return controller(SimulatedVehicle(response, start, wind))
    raise ValueError(f"no autopilot {flavour!r}; there are px4 and ardupilot")


def _is_for_us(message: Any) -> bool:
    """Whether a message is addressed to this vehicle, or to all."""
    system = getattr(message, "target_system", 0)
    component = getattr(message, "target_component", 0)
    return system in (0, SYSTEM_ID) and component in (0, COMPONENT_ID)


def run_autopilot(autopilot: SimAutopilot, clock: Clock, stop: threading.Event) -> None:
    """Step an autopilot in real time until `stop` is set; made to be a thread's target."""
    while not stop.is_set():
        now_s = clock.now()
        autopilot.step(now_s)
        clock.sleep_until(now_s + STEP_S)


@contextmanager
def autopilot_thread(autopilot: SimAutopilot, clock: Clock) -> Iterator[SimAutopilot]:
    """Step an autopilot in real time, on a thread of its own, while entered."""
    stop = threading.Event()
    arguments = (autopilot, clock, stop)
    thread = threading.Thread(target=run_autopilot, args=arguments, name="autopilot", daemon=True)
    thread.start()
    try:
        yield autopilot
    finally:
        stop.set()
        thread.join()
