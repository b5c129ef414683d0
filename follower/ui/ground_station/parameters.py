"""Gains, limits and modes as MAVLink parameters; see docs/ground-station.md."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.ground_station.endpoint import Endpoint
from follower.ground_station.parameter_table import (
    Parameter,
    by_name,
    float32,
    parameters,
)
from follower.operator_requests import OperatorRequests
from follower.target_wish import RequestRefusedError
from follower_control.strict_yaml import SettingsError

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


class ParameterServer:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET; no thread, no clock.

    All parameters are REAL32. One parameter is told after a ground station's heartbeat, because
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
        self._save = save
        self._names = [one.name for one in parameters()] + ([SAVE] if save is not None else [])
        self._plan: list[tuple[float, int]] = []
        self._asked = False
        self._announced_s = self._listed_s = self._told_s = -math.inf
        self._announcements = 0
        self._settings = requests.settings

    def hear(self, message: Any, now_s: float) -> None:
        """Take a PARAM_* message or a heartbeat; those for others are passed over."""
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._on_heartbeat(message, now_s)
        elif not self._is_for_us(message):
            return
        elif kind == "PARAM_REQUEST_LIST":
            self._asked = True
            self._tell_all(now_s)
        elif kind == "PARAM_REQUEST_READ":
            self._asked = True
            self._on_read(message, now_s)
        elif kind == "PARAM_SET":
            self._on_set(message)

    def step(self, now_s: float) -> None:
        """Send what is due: of a list, and what was changed by others."""
        settings = self._requests.settings
        if settings is not self._settings:
            before, self._settings = self._settings, settings
            for index, one in enumerate(parameters()):
                if one.number(before) != one.number(settings):
                    self._tell_surely(index, now_s)
        if now_s - self._told_s >= _EVERY_S:
            self._tell_one(now_s)

    def _tell_one(self, now_s: float) -> None:
        """Send the one that has waited longest, if any is due."""
        due_s, index = min(self._plan, default=(math.inf, 0))
        if due_s <= now_s:
            self._told_s = now_s
            self._plan.remove((due_s, index))
            self._tell(index)

    def _tell_all(self, now_s: float) -> None:
        """Plan all of them; what waits since an earlier question is not put off by this one."""
        self._listed_s = now_s
        waiting = {index: due_s for due_s, index in sorted(self._plan, reverse=True)}
        since = [min(now_s, waiting.get(index, now_s)) for index in range(len(self._names))]
        self._plan = [(s + after_s, index) for index, s in enumerate(since) for after_s in _AGAIN_S]

    def _tell_surely(self, index: int, now_s: float) -> None:
        self._plan = [one for one in self._plan if one[1] != index]
        self._plan += [(now_s + after_s, index) for after_s in _AGAIN_S]

    def _is_for_us(self, message: Any) -> bool:
        ours = message.target_component in (0, self._endpoint.component)
        return ours and message.target_system in (0, self._endpoint.system)

    def _on_heartbeat(self, message: Any, now_s: float) -> None:
        is_station = message.type == mavlink.MAV_TYPE_GCS
        due = now_s - self._announced_s >= _ANNOUNCE_S
        if is_station and due and not self._asked and self._announcements < _ANNOUNCEMENTS:
            self._announced_s = now_s
            self._announcements += 1
            self._tell(0)

    def _on_read(self, message: Any, now_s: float) -> None:
        name = _name_of(message)
        if message.param_index != _BY_NAME:
            if 0 <= message.param_index < len(self._names):
                # Who reads by index wants them all, and his questions may get lost, too.
                if now_s - self._listed_s >= _LIST_AGAIN_S:
                    self._tell_all(now_s)
                self._tell_surely(message.param_index, now_s)
            else:
                self._refuse(message, _MISSING)
        elif name in self._names:
            self._tell_surely(self._names.index(name), now_s)
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
            self._tell(self._names.index(name))
            return
        self._tell(self._names.index(name), number)
        if said:
            self._endpoint.say(said)

    def _set(self, name: str, message: Any) -> str:
        """Change a setting, or save all; return what is to be said about it."""
        number, by = message.param_value, f"ground station {message.get_srcSystem()}"
        if message.param_type != _REAL or not math.isfinite(number):
            raise RequestRefusedError(f"{name} takes a finite number of 32 bits (REAL32)")
        if name == SAVE:
            if number not in (0.0, 1.0):
                raise RequestRefusedError(f"{SAVE} takes 1, to save")
            return self._save() if self._save is not None and number == 1.0 else ""
        one = by_name()[name]
        if float32(number) != one.number(self._requests.settings):
            self._requests.change(one.live.key, one.value(number), by)
        return ""

    def _tell(self, index: int, number: float | None = None) -> None:
        name = self._names[index]
        value = self._number(name) if number is None else number
        count = len(self._names)
        self._endpoint.send(
            mavlink.MAVLink_param_value_message(name.encode(), value, _REAL, count, index)
        )

    def _number(self, name: str) -> float:
        one: Parameter | None = by_name().get(name)
        return 0.0 if one is None else one.number(self._requests.settings)

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
