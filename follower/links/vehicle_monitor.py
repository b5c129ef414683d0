"""What the vehicle tells about itself, taken in."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any, TypeVar

from pymavlink.dialects.v20 import common as mavlink

from follower.links.autopilot_clock import AutopilotClock
from follower.links.modes import mode_name, setpoint_mode
from follower.links.surroundings import (
    clearance_by_rangefinder,
    clearance_by_terrain,
    gimbal_of,
    origin_of,
)
from follower.links.vehicle_finder import Vehicle
from follower_control.vehicle import Attitude, LocalPosition, RcChannels, VehicleState

_T = TypeVar("_T")
_Six = tuple[_T, _T, _T, _T, _T, _T]
_ANGLES_AND_RATES = attrgetter("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
_PLACE_AND_VELOCITY = attrgetter("x", "y", "z", "vx", "vy", "vz")
_MOST_NOTES = 100
_FAILSAFES = (
    mavlink.MAV_STATE_CRITICAL,
    mavlink.MAV_STATE_EMERGENCY,
    mavlink.MAV_STATE_FLIGHT_TERMINATION,
)
_MOST_CHANNELS = 18
_RANGE_HOLDS_S = 2.0
_DONE = (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)


class VehicleMonitor:
    """Turns one vehicle's messages into its state.

    Args:
        vehicle: whose they are; the caller has made sure of that.
        clock: maps the autopilot's times to ours.

    Attributes:
        state: the newest of everything, at the last `settle`.
        attitudes: those since `begin`.
        altitude_msl_m: None before it is known.
        boot_ms: the newest time on the autopilot's own clock.
    """

    def __init__(self, vehicle: Vehicle, clock: AutopilotClock) -> None:
        self._autopilot = vehicle.autopilot
        self._clock = clock
        self._notes: list[str] = []
        self._handlers: dict[str, Callable[[Any, float], None]] = {
            "HEARTBEAT": self._on_heartbeat,
            "ATTITUDE": self._on_attitude,
            "LOCAL_POSITION_NED": self._on_position,
            "GLOBAL_POSITION_INT": self._on_global_position,
            "EXTENDED_SYS_STATE": self._on_landed_state,
            "COMMAND_ACK": self._on_ack,
            "STATUSTEXT": self._on_text,
            "RC_CHANNELS": self._on_rc,
            "DISTANCE_SENSOR": self._on_distance,
            "TERRAIN_REPORT": self._on_terrain,
            "GPS_GLOBAL_ORIGIN": self._on_origin,
            "GIMBAL_DEVICE_ATTITUDE_STATUS": self._on_gimbal,
        }
        self._told: dict[str, Any] = {}
        self._news: dict[str, Any] = {}
        self.state = VehicleState()
        self.attitudes: list[Attitude] = []
        self.altitude_msl_m: float | None = None
        self.boot_ms = 0
        self._range_s = -math.inf

    @property
    def messages(self) -> tuple[str, ...]:
        """Names of the messages that are understood."""
        return tuple(self._handlers)

    def begin(self) -> None:
        """Forget the attitudes of before."""
        self.attitudes = []

    def settle(self) -> None:
        """Put what has come since the last time into the state."""
        if self._news:
            self._told |= self._news
            self.state = VehicleState(**self._told)
            self._news = {}

    def take(self, name: str, message: Any, now_s: float) -> None:
        """Take one message: anything whose attributes are the message's fields."""
        handler = self._handlers.get(name)
        if handler is not None:
            handler(message, now_s)

    def note(self, text: str) -> None:
        """Keep a line for whoever asks next."""
        if len(self._notes) < _MOST_NOTES:
            self._notes.append(text)

    def take_notes(self) -> list[str]:
        """Return the lines since the last call."""
        notes, self._notes = self._notes, []
        return notes

    def _on_heartbeat(self, message: Any, now_s: float) -> None:
        self.settle()
        before = self.state
        mode = mode_name(self._autopilot, message.custom_mode)
        obeys = mode == setpoint_mode(self._autopilot)
        enters = obeys and not before.obeys_setpoints
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        # Who flies already when we come has a mode that nobody chose for us.
        unseen = before.heartbeat_s is None and armed
        if unseen and obeys:
            self.note(f"it flies in {mode} already; to follow, leave that mode and take it again")
        self._news.update(
            mode=mode,
            obeys_setpoints=obeys,
            armed=armed,
            heartbeat_s=now_s,
            failsafe=message.system_status in _FAILSAFES,
            entries=before.entries + enters,
            # PX4 returns into OFFBOARD out of its failsafe alone, as soon as the stream is back.
            entered_by_itself=before.failsafe or unseen if enters else before.entered_by_itself,
        )

    def _on_attitude(self, message: Any, now_s: float) -> None:
        numbers = _finite(_ANGLES_AND_RATES(message))
        if numbers is not None:
            attitude = Attitude(*numbers, self._time_of(message, now_s))
            self.attitudes.append(attitude)
            self._news["attitude"] = attitude

    def _on_position(self, message: Any, now_s: float) -> None:
        numbers = _finite(_PLACE_AND_VELOCITY(message))
        if numbers is not None:
            position = LocalPosition(*numbers, self._time_of(message, now_s))
            self._news["position"] = position

    def _on_global_position(self, message: Any, now_s: float) -> None:
        self._time_of(message, now_s)
        self.altitude_msl_m = message.alt / 1000.0

    def _on_landed_state(self, message: Any, _now_s: float) -> None:
        if message.landed_state != mavlink.MAV_LANDED_STATE_UNDEFINED:
            landed = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
            self._news["landed"] = landed

    def hears_us(self, now_s: float) -> None:
        """Note an answer to something that we asked."""
        self._news["answered_s"] = now_s

    def _on_ack(self, message: Any, now_s: float) -> None:
        # MAVLink 1 has no target here.
        if getattr(message, "target_component", 0) == mavlink.MAV_COMP_ID_ONBOARD_COMPUTER:
            self.hears_us(now_s)
        if message.result not in _DONE:
            command = mavlink.enums["MAV_CMD"].get(message.command)
            result = mavlink.enums["MAV_RESULT"].get(message.result)
            name = command.name if command else message.command
            self.note(f"{name}: {result.name if result else message.result}")

    def _on_text(self, message: Any, _now_s: float) -> None:
        self.note(str(message.text))

    def _on_rc(self, message: Any, now_s: float) -> None:
        count = min(max(int(message.chancount), 0), _MOST_CHANNELS)
        pulses = [int(getattr(message, f"chan{number}_raw")) for number in range(1, count + 1)]
        if pulses:
            self._news["rc"] = RcChannels(tuple(pulses), now_s)

    def _on_distance(self, message: Any, now_s: float) -> None:
        clearance = clearance_by_rangefinder(message, now_s)
        if clearance is not None:
            self._range_s = now_s
            self._news["clearance"] = clearance

    def _on_terrain(self, message: Any, now_s: float) -> None:
        # A rangefinder knows better than a map.
        clearance = clearance_by_terrain(message, now_s)
        if clearance is not None and now_s - self._range_s > _RANGE_HOLDS_S:
            self._news["clearance"] = clearance

    def _on_origin(self, message: Any, _now_s: float) -> None:
        origin = origin_of(message)
        if origin is not None:
            self._news["origin"] = origin

    def _on_gimbal(self, message: Any, now_s: float) -> None:
        self.take_gimbal(message, self._time_of(message, now_s))

    def take_gimbal(self, message: Any, time_s: float) -> None:
        """Take a gimbal's attitude that was true at a time of ours."""
        gimbal = gimbal_of(message, time_s)
        if gimbal is not None:
            self._news["gimbal"] = gimbal

    def _time_of(self, message: Any, now_s: float) -> float:
        self.boot_ms = message.time_boot_ms
        return self._clock.to_system(message.time_boot_ms / 1000.0, now_s)


def _finite(numbers: _Six[Any]) -> _Six[float] | None:
    """Return the numbers, None unless each is a finite one."""
    return numbers if None not in numbers and all(map(math.isfinite, numbers)) else None
