"""The same parameters by the extended protocol, which ground stations use for a camera's settings.

See https://mavlink.io/en/services/parameter_ext.html and `camera_definition`.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.ground_station.endpoint import Endpoint
from follower.ground_station.parameter_table import by_name, float32, parameters
from follower.operator_requests import OperatorRequests
from follower.target_wish import RequestRefusedError
from follower_control.strict_yaml import SettingsError

_REAL = int(mavlink.MAV_PARAM_EXT_TYPE_REAL32)
_BY_NAME = -1
_EVERY_S = 0.038
"""Each of them is 161 bytes: a radio of 57600 baud has room for the telemetry beside."""


class ParameterExtServer:
    """Answers PARAM_EXT_REQUEST_LIST, PARAM_EXT_REQUEST_READ and PARAM_EXT_SET.

    Args:
        endpoint: sends as the camera.
        requests: what is changed goes there.
    """

    def __init__(self, endpoint: Endpoint, requests: OperatorRequests) -> None:
        self._endpoint = endpoint
        self._requests = requests
        self._names = [one.name for one in parameters()]
        self._waiting: deque[int] = deque()
        self._told_s = -math.inf
        self._settings = requests.settings

    def hear(self, message: Any) -> None:
        """Take a PARAM_EXT_* message; those for others are passed over."""
        kind = message.get_type()
        ours = message.target_component in (0, self._endpoint.component)
        if not ours or message.target_system not in (0, self._endpoint.system):
            return
        if kind == "PARAM_EXT_REQUEST_LIST":
            self._plan(range(len(self._names)))
        elif kind == "PARAM_EXT_REQUEST_READ":
            self._on_read(message)
        elif kind == "PARAM_EXT_SET" and self._endpoint.is_for(message):
            self._on_set(message)

    def step(self, now_s: float) -> None:
        """Send what is due: of a list, and what was changed by others."""
        settings = self._requests.settings
        if settings is not self._settings:
            before, self._settings = self._settings, settings
            changed = [one.number(before) != one.number(settings) for one in parameters()]
            self._plan(index for index, is_other in enumerate(changed) if is_other)
        if self._waiting and now_s - self._told_s >= _EVERY_S:
            self._told_s = now_s
            self._tell(self._waiting.popleft())

    def _plan(self, indices: Iterable[int]) -> None:
        """Have these told, each once, after what waits already."""
        self._waiting += [one for one in indices if one not in self._waiting]

    def _on_read(self, message: Any) -> None:
        """Tell one; the protocol has no answer for what is not there."""
        index = message.param_index
        if index == _BY_NAME and message.param_id in self._names:
            index = self._names.index(message.param_id)
        if 0 <= index < len(self._names):
            self._tell(index)

    def _on_set(self, message: Any) -> None:
        name = message.param_id
        if name not in self._names:
            self._acknowledge(name, 0.0, int(mavlink.PARAM_ACK_FAILED))
            return
        try:
            self._set(name, message)
        except (RequestRefusedError, SettingsError) as refusal:
            self._acknowledge(name, self._number(name), int(mavlink.PARAM_ACK_VALUE_UNSUPPORTED))
            self._endpoint.say(str(refusal), mavlink.MAV_SEVERITY_WARNING)
        else:
            self._acknowledge(name, self._number(name), int(mavlink.PARAM_ACK_ACCEPTED))

    def _set(self, name: str, message: Any) -> None:
        # pymavlink's own `param_value` is a text, cut at the first zero byte.
        (number,) = struct.unpack("<f", bytes(message._param_value_raw).ljust(4, b"\0")[:4])
        if message.param_type != _REAL or not math.isfinite(number):
            raise RequestRefusedError(f"{name} takes a finite number of 32 bits (REAL32)")
        one = by_name()[name]
        if float32(number) != one.number(self._requests.settings):
            by = f"ground station {message.get_srcSystem()}"
            self._requests.change(one.live.key, one.value(number), by)

    def _number(self, name: str) -> float:
        return by_name()[name].number(self._requests.settings)

    def _tell(self, index: int) -> None:
        name, count = self._names[index], len(self._names)
        value = struct.pack("<f", self._number(name))
        self._endpoint.send(
            mavlink.MAVLink_param_ext_value_message(name.encode(), value, _REAL, count, index)
        )

    def _acknowledge(self, name: str, number: float, result: int) -> None:
        value = struct.pack("<f", number)
        self._endpoint.send(
            mavlink.MAVLink_param_ext_ack_message(name.encode(), value, _REAL, result)
        )
