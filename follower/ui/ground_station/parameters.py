"""Gains, limits and modes as MAVLink parameters; see docs/how-to/ground-station.md.

The settings that may change in flight, as parameters of at most 16 characters.

The names are made from the settings' own, word by word, so that a new setting has one by itself:
servo.range.derivative_filter_s is SRV_RNG_DFLT. What is no number is a number here: a truth is 0 or
1, an enumeration counts its members from 0, and none is -1000.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.operator_requests import OperatorRequests
from follower.flight.target.request import RequestRefusedError
from follower.settings.live import LiveKey, live_keys, value_at
from follower.settings.settings import Settings
from follower.ui.ground_station.camera_messages import Endpoint
from follower_control.common.strict_config import SettingsError

NONE = -1000.0
SAVE = "CFG_SAVE"
"""Setting it to 1 writes the changed settings into their file."""
_REAL = int(mavlink.MAV_PARAM_TYPE_REAL32)
_MISSING = int(mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST)
_OUT_OF_RANGE = int(mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)
_BY_NAME = -1
_EVERY_S = 0.018
"""A radio of 57600 baud has room for the telemetry beside so many."""
_AGAIN_S = (0.0, 0.5, 2.0)
_LIST_AGAIN_S = 10.0
_ANNOUNCE_S, _ANNOUNCEMENTS = 5.0, 12
_UNITS = ("_m_s2", "_m_s3", "_deg_s", "_m_s", "_deg", "_m", "_s")
_WORDS = {
    "servo": "SRV",
    "search": "SRCH",
    "envelope": "ENV",
    "supervisor": "SUP",
    "azimuth": "AZ",
    "elevation": "EL",
    "range": "RNG",
    "bearing": "BRG",
    "orbit": "ORB",
    "overhead": "OVH",
    "derivative": "D",
    "filter": "FLT",
    "tracking": "TRK",
    "tolerance": "TOL",
    "bumpless": "BMP",
    "distance": "DIST",
    "target": "TGT",
    "middle": "MID",
    "height": "HGT",
    "centred": "CTR",
    "forward": "FWD",
    "backward": "BCK",
    "vertical": "VRT",
    "sideways": "SWY",
    "speed": "SPD",
    "acceleration": "ACC",
    "rate": "RT",
    "error": "ERR",
    "course": "CRS",
    "clearance": "CLR",
    "descent": "DSC",
    "climb": "CLB",
    "ceiling": "CEIL",
    "fence": "FNC",
    "radius": "RAD",
}


@dataclass(frozen=True, slots=True)
class GroundStationParameter:
    """One setting as a parameter.

    Attributes:
        name: at most 16 characters; what is before the first "_" is its group.
        live: the setting.
    """

    name: str
    live: LiveKey

    @property
    def members(self) -> tuple[Any, ...]:
        """The values that it counts, nothing for a number."""
        if self.live.kind is bool:
            return False, True
        return tuple(self.live.kind) if issubclass(self.live.kind, Enum) else ()

    def number(self, settings: Settings) -> float:
        """Return its value in these settings, in their unit, as the nearest 32-bit number."""
        value = value_at(settings, self.live.key)
        members = self.members
        if value is None or (members and value not in members):  # a follow mode of a package
            return NONE
        return float32(members.index(value) if members else value)

    def value(self, number: float) -> Any:
        """Return what a setting becomes by this number.

        Raises:
            SettingsError: it stands for no value.
        """
        if number == NONE and self.live.optional:
            return None
        if self.members:
            if number not in range(len(self.members)):
                most = len(self.members) - 1
                raise SettingsError(f"{self.name} is a whole number from 0 to {most}")
            return self.members[int(number)]
        return shortest(number)


@cache
def parameters() -> tuple[GroundStationParameter, ...]:
    """Return all parameters, in the order of the settings."""
    keys = live_keys()
    short = [_name(one.key, with_unit=False) for one in keys]
    names = [
        name if short.count(name) == 1 else _name(one.key, with_unit=True)
        for one, name in zip(keys, short, strict=True)
    ]
    return tuple(map(GroundStationParameter, names, keys))


@cache
def by_name() -> dict[str, GroundStationParameter]:
    """Return all parameters by their names."""
    return {one.name: one for one in parameters()}


def float32(value: float) -> float:
    """Return the nearest 32-bit number; infinite beyond them."""
    with np.errstate(over="ignore"):
        return float(np.float32(value))


def shortest(number: float) -> float:
    """Return the decimal with the fewest digits whose 32-bit number this is: 0.7, not 0.69999..."""
    return float(str(np.float32(number)))


def _name(key: str, with_unit: bool) -> str:
    unit = next((ending for ending in _UNITS if key.endswith(ending)), "")
    parts = (key.removesuffix(unit) + (unit if with_unit else "")).split(".")
    return "_".join(map(_abbreviated, parts))


def _abbreviated(words: str) -> str:
    return "".join(_WORDS.get(word, word.upper()) for word in words.split("_"))


class ParameterServer:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; no thread, no clock.

    All parameters are REAL32. One parameter is sent after a ground station's heartbeat, because
    QGroundControl asks a companion's component for its list only then; again every five seconds
    until somebody asks for something. A list leaves one by one, and each of it three times: a
    ground station that misses one of them for good waits with the vehicle's own.

    Args:
        endpoint: sends as the component whose parameters these are.
        requests: what is changed goes there.
        save: writes the changed settings to their file and says where; None without a file.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        requests: OperatorRequests,
        save: Callable[[], str] | None = None,
    ) -> None:
        self._endpoint = endpoint
        self._requests = requests
        self._names = [one.name for one in parameters()]
        self._settings = requests.settings
        self._save = save
        if save is not None:
            self._names.append(SAVE)
        self._plan: list[tuple[float, int]] = []
        self._asked = False
        self._announced_s = self._listed_s = self._sent_s = -math.inf
        self._announcements = 0

    def hear(self, message: Any, now_s: float) -> None:
        """Take a PARAM_* message or a heartbeat; those for others are passed over."""
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._on_heartbeat(message, now_s)
        elif not self._is_for_us(message):
            return
        elif kind == "PARAM_REQUEST_LIST":
            self._asked = True
            self._plan_all(now_s)
        elif kind == "PARAM_REQUEST_READ":
            self._asked = True
            self._on_read(message, now_s)
        elif kind == "PARAM_SET":
            self._on_set(message)

    def step(self, now_s: float) -> None:
        """Send what is due: of a list, and what was changed by others."""
        for index in self._changed():
            self._send_repeatedly(index, now_s)
        if now_s - self._sent_s >= _EVERY_S:
            self._send_due(now_s)

    def _send_due(self, now_s: float) -> None:
        """Send the one that has waited longest, if any is due."""
        due_s, index = min(self._plan, default=(math.inf, 0))
        if due_s <= now_s:
            self._sent_s = now_s
            self._plan.remove((due_s, index))
            self._send(index)

    def _plan_all(self, now_s: float) -> None:
        """Plan all of them; what waits since an earlier request is not postponed by this one."""
        self._listed_s = now_s
        waiting = {index: due_s for due_s, index in sorted(self._plan, reverse=True)}
        since = [min(now_s, waiting.get(index, now_s)) for index in range(len(self._names))]
        self._plan = [(s + after_s, index) for index, s in enumerate(since) for after_s in _AGAIN_S]

    def _send_repeatedly(self, index: int, now_s: float) -> None:
        self._plan = [one for one in self._plan if one[1] != index]
        self._plan += [(now_s + after_s, index) for after_s in _AGAIN_S]

    def _on_heartbeat(self, message: Any, now_s: float) -> None:
        is_station = message.type == mavlink.MAV_TYPE_GCS
        due = now_s - self._announced_s >= _ANNOUNCE_S
        if is_station and due and not self._asked and self._announcements < _ANNOUNCEMENTS:
            self._announced_s = now_s
            self._announcements += 1
            self._send(0)

    def _on_read(self, message: Any, now_s: float) -> None:
        name = _name_of(message)
        if message.param_index != _BY_NAME:
            if 0 <= message.param_index < len(self._names):
                # Who reads by index wants them all, and its requests may get lost, too.
                if now_s - self._listed_s >= _LIST_AGAIN_S:
                    self._plan_all(now_s)
                self._send_repeatedly(message.param_index, now_s)
            else:
                self._refuse(message, _MISSING)
        elif name in self._names:
            self._send_repeatedly(self._names.index(name), now_s)
        elif message.target_component == self._endpoint.component:
            self._refuse(message, _MISSING)

    def _on_set(self, message: Any) -> None:
        name, number = _name_of(message), message.param_value
        if name not in self._names:
            if message.target_component == self._endpoint.component:
                self._refuse(message, _MISSING)
            return
        try:
            said = self._set(name, message)
        except (RequestRefusedError, SettingsError) as refusal:
            self._refuse(message, _OUT_OF_RANGE)
            self._endpoint.say(str(refusal), mavlink.MAV_SEVERITY_WARNING)
            self._send(self._names.index(name))
            return
        self._send(self._names.index(name), number)
        if said:
            self._endpoint.say(said)

    def _set(self, name: str, message: Any) -> str:
        """Change a setting, or save all; return what is to be said about it."""
        number = message.param_value
        if message.param_type != mavlink.MAV_PARAM_TYPE_REAL32 or not math.isfinite(number):
            raise RequestRefusedError(f"{name} takes a finite number of 32 bits (REAL32)")
        if name == SAVE:
            if number not in (0.0, 1.0):
                raise RequestRefusedError(f"{SAVE} takes 1, to save")
            return self._save() if self._save is not None and number == 1.0 else ""
        one = by_name()[name]
        if float32(number) != one.number(self._requests.settings):
            by = f"ground station {message.get_srcSystem()}"
            self._requests.change(one.live.key, one.value(number), by)
        return ""

    def _is_for_us(self, message: Any) -> bool:
        ours = message.target_component in (0, self._endpoint.component)
        return ours and message.target_system in (0, self._endpoint.system)

    def _changed(self) -> list[int]:
        """Return the indices of what was changed since the last call, by whomever."""
        before, self._settings = self._settings, self._requests.settings
        if before is self._settings:
            return []
        numbered = enumerate(parameters())
        return [i for i, one in numbered if one.number(before) != one.number(self._settings)]

    def _number(self, name: str) -> float:
        one = by_name().get(name)
        return 0.0 if one is None else one.number(self._requests.settings)

    def _send(self, index: int, number: float | None = None) -> None:
        name = self._names[index]
        value = self._number(name) if number is None else number
        count = len(self._names)
        self._endpoint.send(
            mavlink.MAVLink_param_value_message(name.encode(), value, _REAL, count, index)
        )

    def _refuse(self, message: Any, error: int) -> None:
        index = getattr(message, "param_index", _BY_NAME)
        sender = message.get_srcSystem(), message.get_srcComponent()
        self._endpoint.send(
            mavlink.MAVLink_param_error_message(*sender, _name_of(message).encode(), index, error)
        )


def _name_of(message: Any) -> str:
    name = message.param_id
    text = name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)
    return text.rstrip("\0")
