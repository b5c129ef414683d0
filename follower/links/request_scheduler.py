"""What a link requests from its vehicle: messages at their rates, health and mode."""

import math
import struct
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.vehicle_finder import FoundVehicle
from follower.settings.link import LinkSettings

_WINDOW_S = 2.0
_FIRST_WAIT_S = 3.0
_LONGEST_WAIT_S = 30.0
_ENOUGH = 0.4
"""Share of the wanted rate that will do: ArduCopter gives 50 Hz of 100 on some links."""
_GIMBAL_HZ, _GIMBAL_STATUS_HZ, _ORIGIN_HZ, _HEALTH_HZ = 50.0, 1.0, 0.5, 1.0
_ORIGIN = "GPS_GLOBAL_ORIGIN"
"""PX4 1.18 sends it only when it changes, whatever rate is asked for: it is requested singly."""
_NOT_EVERYWHERE = (
    "RC_CHANNELS",
    "DISTANCE_SENSOR",
    "TERRAIN_REPORT",
    _ORIGIN,
    "HOME_POSITION",
    "GIMBAL_MANAGER_STATUS",
)
_ASK_VERSION_S = 1.0
_SLACK_S = 1e-6


@dataclass(frozen=True, slots=True)
class MessageRate:
    """One message: how often it is requested, and how often it comes, in Hz."""

    name: str
    wanted_hz: float
    measured_hz: float

    @property
    def is_enough(self) -> bool:
        """Whether it comes often enough to fly with."""
        return self.measured_hz >= _ENOUGH * self.wanted_hz


@dataclass(slots=True)
class _Requested:
    """One message that is wanted at a rate.

    Attributes:
        wanted_hz: how often.
        arrivals: when it came in the last two seconds.
        ask_s: when to ask, or to look whether it comes.
        wait_s: how long to wait after asking.
        is_asked: whether it was asked for at all.
        is_slow: whether it was reported as too slow.
    """

    wanted_hz: float
    arrivals: deque[float] = field(default_factory=deque)
    ask_s: float = -math.inf
    wait_s: float = _FIRST_WAIT_S
    is_asked: bool = False
    is_slow: bool = False


class MessageRates:
    """Counts messages over two seconds and decides which ones to ask for.

    What stays slow is asked for again after 3 s, then 6 s, up to every 30 s.

    Args:
        wanted_hz: by message name.
        optional: names of messages that not every vehicle has: nothing is said if they are slow.
    """

    def __init__(self, wanted_hz: Mapping[str, float], optional: Collection[str] = ()) -> None:
        self._messages = {name: _Requested(rate_hz) for name, rate_hz in wanted_hz.items()}
        self._optional = frozenset(optional)
        self._next_ask_s = -math.inf

    def want(self, name: str, rate_hz: float) -> None:
        """Have one more message asked for, in Hz."""
        if name not in self._messages:
            self._messages[name] = _Requested(rate_hz)
            self._next_ask_s = -math.inf

    def ask_anew(self) -> None:
        """Have everything asked for at once: the autopilot may have been restarted."""
        for message in self._messages.values():
            message.ask_s, message.wait_s, message.is_asked = -math.inf, _FIRST_WAIT_S, False
        self._next_ask_s = -math.inf

    def count(self, name: str, now_s: float) -> None:
        """Count one message that came at `now_s`, in seconds."""
        message = self._messages.get(name)
        if message is not None:
            message.arrivals.append(now_s)
            while message.arrivals[0] <= now_s - _WINDOW_S:
                message.arrivals.popleft()

    def measured(self, now_s: float) -> tuple[MessageRate, ...]:
        """Return all rates over the last two seconds; may be called from any thread."""
        return tuple(_rate(*one, now_s) for one in tuple(self._messages.items()))

    def due(self, now_s: float) -> tuple[MessageRate, ...]:
        """Return what is to be asked for now: all at first, then what comes too seldom."""
        if now_s < self._next_ask_s:
            return ()
        due = []
        for name, message in self._messages.items():
            if now_s < message.ask_s:
                continue
            rate = _rate(name, message, now_s)
            again = message.is_asked and not rate.is_enough
            message.wait_s = min(2 * message.wait_s, _LONGEST_WAIT_S) if again else _FIRST_WAIT_S
            if again or not message.is_asked:
                due.append(rate)
                message.is_asked = True
                message.ask_s = now_s + message.wait_s
            else:
                message.ask_s = now_s + _WINDOW_S / 2
        self._next_ask_s = min((one.ask_s for one in self._messages.values()), default=math.inf)
        return tuple(due)

    def changes(self, now_s: float) -> list[str]:
        """Return in words which messages became too slow or normal again since the last call."""
        notes: list[str] = []
        for name, message in self._messages.items():
            rate = _rate(name, message, now_s)
            if name in self._optional or rate.is_enough != message.is_slow:
                continue
            hz = rate.measured_hz
            if rate.is_enough:
                message.is_slow = False
                notes.append(f"{name} comes at {hz:.0f} Hz again")
            elif message.is_asked and now_s > message.ask_s - _WINDOW_S / 2:
                message.is_slow = True
                notes.append(
                    f"{name} comes at {hz:.1f} Hz, not at {message.wanted_hz:.0f}; asking again"
                )
        return notes


def _rate(name: str, message: _Requested, now_s: float) -> MessageRate:
    # From other threads, too: arrivals may come and go meanwhile.
    arrivals = tuple(message.arrivals)
    recent = len(arrivals) - bisect_right(arrivals, now_s - _WINDOW_S)
    return MessageRate(name, message.wanted_hz, recent / _WINDOW_S)


class RequestScheduler:
    """Asks for what does not come by itself, and again when it stops.

    Args:
        settings: the rates in Hz.
        command: sends a command to the autopilot, with its parameters.
    """

    def __init__(self, settings: LinkSettings, command: Callable[..., None]) -> None:
        self._settings = settings
        self._command = command
        rates = {
            "ATTITUDE": settings.attitude_rate_hz,
            "LOCAL_POSITION_NED": settings.position_rate_hz,
            "GLOBAL_POSITION_INT": 2.0,
            "EXTENDED_SYS_STATE": 5.0,
            "RC_CHANNELS": settings.rc_rate_hz,
            "DISTANCE_SENSOR": settings.clearance_rate_hz,
            "TERRAIN_REPORT": settings.clearance_rate_hz,
            _ORIGIN: _ORIGIN_HZ,
            "HOME_POSITION": _ORIGIN_HZ,
        }
        wanted = {name: rate for name, rate in rates.items() if rate > 0}
        self.rates = MessageRates(wanted, optional=_NOT_EVERYWHERE)
        self._watches_health = False
        self._mode_asked_s = self._version_asked_s = -math.inf

    def watch_gimbal(self) -> None:
        """From now on request a gimbal's attitude and who controls it."""
        self.rates.want("GIMBAL_DEVICE_ATTITUDE_STATUS", _GIMBAL_HZ)
        self.rates.want("GIMBAL_MANAGER_STATUS", _GIMBAL_STATUS_HZ)

    def watch_health(self, vehicle: FoundVehicle | None) -> None:
        """From now on request health; of a vehicle that is not found yet, once it is."""
        self._watches_health = True
        if vehicle is not None:
            self.begin(vehicle)

    def begin(self, vehicle: FoundVehicle) -> None:
        """Request what this kind of autopilot reports."""
        if self._watches_health:
            px4 = vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4
            estimator = "ESTIMATOR_STATUS" if px4 else "EKF_STATUS_REPORT"
            for name in ("SYS_STATUS", "GPS_RAW_INT", estimator):
                self.rates.want(name, _HEALTH_HZ)

    def ask(self, now_s: float, steered: bool, has_firmware: bool) -> list[str]:
        """Ask for what does not come; return what is to be noted about the rates.

        Args:
            now_s: the time in seconds.
            steered: whether the autopilot obeys setpoints, or may by now: then its mode is asked
                for often.
            has_firmware: whether the firmware's version is known.
        """
        notes = self.rates.changes(now_s)
        if steered:
            self._ask_for_mode(now_s)
        for rate in self.rates.due(now_s):
            number = float(getattr(mavlink, f"MAVLINK_MSG_ID_{rate.name}"))
            if rate.name == _ORIGIN:
                self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)
            else:
                self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate.wanted_hz)
        unknown = self._watches_health and not has_firmware
        if unknown and now_s - self._version_asked_s >= _ASK_VERSION_S:
            self._version_asked_s = now_s
            number = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)
        return notes

    def _ask_for_mode(self, now_s: float) -> None:
        """Ask for a heartbeat out of turn, to see soon when the pilot takes another mode.

        PX4 refuses to send heartbeats at another rate than 1 Hz.
        """
        rate_hz = self._settings.mode_rate_hz
        if rate_hz > 0 and now_s - self._mode_asked_s >= 1 / rate_hz - _SLACK_S:
            self._mode_asked_s = now_s
            number = float(mavlink.MAVLINK_MSG_ID_HEARTBEAT)
            self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)


_RETRY_S = 0.6
_TRIES = 6
_AT_ONCE = 8
_EARLY_S = 1e-3
_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B3x",
    mavlink.MAV_PARAM_TYPE_INT8: "<b3x",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H2x",
    mavlink.MAV_PARAM_TYPE_INT16: "<h2x",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


class ParameterReader:
    """Decides which names to ask for and when, and keeps the answers; it sends nothing itself.

    A name that stays unanswered is asked for six times in all, 0.6 s apart, a few names at once so
    that a slow radio is not flooded.

    Attributes:
        bytewise: integers come as their bytes, as PX4 sends them; else as floats.
        values: what was answered so far, by name.
    """

    def __init__(self, bytewise: bool = False) -> None:
        self.bytewise = bytewise
        self.values: dict[str, float] = {}
        self._tries: dict[str, int] = {}
        self._asked_s: dict[str, float] = {}

    @property
    def missing(self) -> frozenset[str]:
        """What was asked for in vain."""
        return frozenset(n for n in self._open() if self._tries[n] >= _TRIES)

    def want(self, names: Iterable[str]) -> None:
        """Have these read, too."""
        for name in names:
            self._tries.setdefault(name, 0)

    def due(self, now_s: float) -> list[str]:
        """Return the names to ask for at `now_s` (seconds); they count as asked."""
        names = [name for name in self._open() if self._tries[name] < _TRIES]
        due = [n for n in names if now_s - self._asked_s.get(n, -math.inf) >= _RETRY_S - _EARLY_S]
        for name in due[:_AT_ONCE]:
            self._asked_s[name] = now_s
            self._tries[name] += 1
        return due[:_AT_ONCE]

    def take(self, name: str, carried: float, kind: int) -> None:
        """Take a PARAM_VALUE of a MAV_PARAM_TYPE; only what was asked for and is finite is kept."""
        form = _INTEGERS.get(kind) if self.bytewise else None
        if form is not None:
            carried = float(struct.unpack(form, struct.pack("<f", carried))[0])
        if name in self._tries and math.isfinite(carried):
            self.values[name] = carried

    def _open(self) -> list[str]:
        return [name for name in self._tries if name not in self.values]
