"""The vehicle's state, from its messages."""

import math
from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import Any, TypeVar

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.clock_sync import AutopilotClock
from follower_control.vehicle.state import (
    Attitude,
    Clearance,
    GimbalState,
    LocalPosition,
    Origin,
    RcChannels,
    VehicleState,
)
from follower_vision.geometry.line_of_sight import roll_pitch_yaw

_PX4_EXTRA = {(4, 1): "READY", (4, 9): "PRECLAND"}
"""Sub-modes that pymavlink 2.4.50 does not name (px4_custom_mode.h)."""


def mode_name(autopilot: int, custom_mode: int) -> str:
    """Return the name of a heartbeat's mode, e.g. "OFFBOARD" or "GUIDED"."""
    if autopilot == mavlink.MAV_AUTOPILOT_PX4:
        name = str(mavutil.interpret_px4_mode(0, custom_mode))
        main_and_sub = (custom_mode >> 16) & 0xFF, custom_mode >> 24
        return _PX4_EXTRA.get(main_and_sub, name) if name == "UNKNOWN" else name
    return str(mavutil.mode_mapping_acm.get(custom_mode, f"MODE {custom_mode}"))


def setpoint_mode(autopilot: int) -> str:
    """Return the mode in which the autopilot flies velocity setpoints."""
    return "OFFBOARD" if autopilot == mavlink.MAV_AUTOPILOT_PX4 else "GUIDED"


def hold_mode(autopilot_name: str) -> str:
    """Return the mode in which the autopilot, "px4" or "ardupilot", stands still by itself."""
    return "LOITER" if autopilot_name == "px4" else "BRAKE"


def set_mode_params(autopilot: int, name: str) -> tuple[float, float, float]:
    """Return parameters 1 to 3 of MAV_CMD_DO_SET_MODE for a mode by its name.

    Raises:
        ValueError: the autopilot has no mode of that name.
    """
    custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    if autopilot == mavlink.MAV_AUTOPILOT_PX4:
        if name not in mavutil.px4_map:
            raise ValueError(f"PX4 has no mode {name!r}; it has {', '.join(mavutil.px4_map)}")
        _, main, sub = mavutil.px4_map[name]
        return custom, float(main), float(sub)
    numbers = {mode: number for number, mode in mavutil.mode_mapping_acm.items()}
    if name not in numbers:
        raise ValueError(f"ArduCopter has no mode {name!r}; it has {', '.join(numbers)}")
    return custom, float(numbers[name]), 0.0


_LEVEL = mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK  # a gimbal of two axes has no roll to lock
_FROM_NORTH = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
_FROM_NOSE = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
_LOCKED = mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
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
_HIGHEST_MM = 20_000_000
"""PX4 says something absurd of home before it knows its altitude."""
_DONE = (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)


def clearance_by_rangefinder(message: Any, time_s: float) -> Clearance | None:
    """Return the height (m) by a downward DISTANCE_SENSOR; None if it measures no ground."""
    looks_down = message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
    within = message.min_distance < message.current_distance < message.max_distance
    if not looks_down or not within or message.signal_quality == 1:
        return None
    return Clearance(message.current_distance / 100.0, time_s)


def gimbal_of(message: Any, time_s: float) -> GimbalState | None:
    """Return a gimbal's attitude in rad, valid at `time_s`; None if it is not finite."""
    quaternion = [float(value) for value in message.q]
    size = math.sqrt(sum(value * value for value in quaternion))
    if not (math.isfinite(size) and 0.5 < size < 2.0):
        return None
    roll, pitch, yaw = roll_pitch_yaw(*(value / size for value in quaternion))
    rates = (message.angular_velocity_x, message.angular_velocity_y, message.angular_velocity_z)
    known = [rate if math.isfinite(rate) else 0.0 for rate in rates]
    flags = int(message.flags)
    from_north = bool(flags & _FROM_NORTH) or (not flags & _FROM_NOSE and bool(flags & _LOCKED))
    attitude = Attitude(roll, pitch, yaw, known[0], known[1], known[2], time_s)
    return GimbalState(attitude, bool(flags & _LEVEL), from_north)


_PART, _LONGEST_PAUSE_S = 50, 2.0


class _TextJoiner:
    """Joins the parts of a text that is longer than one STATUSTEXT; a part not full is the last.

    What stays incomplete is given as far as it came.
    """

    def __init__(self) -> None:
        self._text = ""
        self._newest = (0, 0, "")
        self._came_s = -math.inf

    def take(self, message: Any, now_s: float) -> list[str]:
        """Take a STATUSTEXT; return the texts that are over."""
        number, part, text = newest = message.id, message.chunk_seq, str(message.text)
        if number == 0:
            return [*self.rest(), text]
        if newest == self._newest:
            return []  # the network doubled it
        before = [] if (number, part - 1) == self._newest[:2] else self.rest()
        self._newest, self._came_s = newest, now_s
        self._text += text
        return before if len(text) == _PART else before + self.rest()

    def rest(self, now_s: float = math.inf) -> list[str]:
        """Return what has come of a text whose next part is not to be expected any more."""
        if not self._text or now_s - self._came_s <= _LONGEST_PAUSE_S:
            return []
        text, self._text = self._text, ""
        return [text]


class VehicleMonitor:
    """Turns one vehicle's messages into its state.

    Args:
        clock: maps the autopilot's times to ours.

    Attributes:
        autopilot: MAV_AUTOPILOT of the vehicle, once it is found.
        state: the newest of everything, at the last `settle`.
        attitudes: those since `begin`.
        altitude_msl_m: height above mean sea level, metres; None before it is known.
        boot_ms: the newest time since boot on the autopilot's own clock, milliseconds.
    """

    def __init__(self, clock: AutopilotClock) -> None:
        self.autopilot = int(mavlink.MAV_AUTOPILOT_INVALID)
        self._clock = clock
        self._notes: list[str] = []
        self._texts = _TextJoiner()
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
            "HOME_POSITION": self._on_home,
            "GIMBAL_DEVICE_ATTITUDE_STATUS": self._on_gimbal,
        }
        self._known: dict[str, Any] = {}
        self._news: dict[str, Any] = {}
        self.state = VehicleState()
        self.attitudes: list[Attitude] = []
        self.altitude_msl_m: float | None = None
        self._origin: tuple[Origin, float] | None = None
        self._home: tuple[Origin, float] | None = None
        self.boot_ms = 0
        self._range_s = -math.inf

    def begin(self) -> None:
        """Forget the attitudes of before."""
        self.attitudes = []

    def settle(self) -> None:
        """Put what has come since the last time into the state."""
        if self._news:
            self._known |= self._news
            self.state = VehicleState(**self._known)
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
        self._tell(self._texts.rest(now_s))
        self.settle()
        before = self.state
        mode = mode_name(self.autopilot, message.custom_mode)
        obeys = mode == setpoint_mode(self.autopilot)
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
            time_s = self._time_of(message, now_s)
            self._news["position"] = LocalPosition(*numbers, time_s, self._home_m)

    def _on_global_position(self, message: Any, now_s: float) -> None:
        self._time_of(message, now_s)
        self.altitude_msl_m = message.alt / 1000.0

    def _on_landed_state(self, message: Any, _now_s: float) -> None:
        if message.landed_state != mavlink.MAV_LANDED_STATE_UNDEFINED:
            landed = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
            self._news["landed"] = landed

    def note_answer(self, now_s: float) -> None:
        """Note an answer to something that we asked."""
        self._news["answered_s"] = now_s

    def _on_ack(self, message: Any, now_s: float) -> None:
        asked_by = getattr(message, "target_component", 0)  # MAVLink 1 has no target here
        if asked_by == mavlink.MAV_COMP_ID_ONBOARD_COMPUTER:
            self.note_answer(now_s)
        elif asked_by:
            return
        if message.result not in _DONE:
            command = mavlink.enums["MAV_CMD"].get(message.command)
            result = mavlink.enums["MAV_RESULT"].get(message.result)
            name = command.name if command else message.command
            self.note(f"{name}: {result.name if result else message.result}")

    def _on_text(self, message: Any, now_s: float) -> None:
        self._tell(self._texts.take(message, now_s))

    def _tell(self, texts: Iterable[str]) -> None:
        for text in texts:  # which may command a terminal
            self.note("".join(letter if letter.isprintable() else " " for letter in text))

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
        loaded = message.loaded > 0 and message.pending == 0
        height_m = float(message.current_height)
        if loaded and math.isfinite(height_m) and now_s - self._range_s > _RANGE_HOLDS_S:
            self._news["clearance"] = Clearance(height_m, now_s)

    def _on_origin(self, message: Any, _now_s: float) -> None:
        if message.latitude != 0 or message.longitude != 0:  # it has none yet
            self._origin = _place_of(message)
            self._news["origin"] = self._origin[0]

    def _on_home(self, message: Any, _now_s: float) -> None:
        # Moved in flight it would move heights and fence under the vehicle.
        landed = self.state.landed
        flies = self.state.armed if landed is None else not landed
        told = message.latitude != 0 or message.longitude != 0
        if told and abs(message.altitude) < _HIGHEST_MM and not (flies and self._home):
            self._home = _place_of(message)

    @property
    def _home_m(self) -> tuple[float, float, float] | None:
        """Where home is, NED from the origin. ArduPilot keeps that origin until it is restarted."""
        if self._home is None or self._origin is None:
            return None
        (origin, origin_m), (home, home_m) = self._origin, self._home
        north_m, east_m = origin.local(home.latitude_deg, home.longitude_deg)
        return north_m, east_m, origin_m - home_m

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


def _place_of(message: Any) -> tuple[Origin, float]:
    """Take the place and its altitude, metres, from GPS_GLOBAL_ORIGIN or HOME_POSITION."""
    return Origin(message.latitude / 1e7, message.longitude / 1e7), message.altitude / 1e3


def _finite(numbers: _Six[Any]) -> _Six[float] | None:
    """Return the numbers, None unless each is a finite one."""
    return numbers if all(map(math.isfinite, numbers)) else None
