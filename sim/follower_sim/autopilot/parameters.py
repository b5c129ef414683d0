"""PARAM_REQUEST_READ, PARAM_REQUEST_LIST and PARAM_SET, as the two autopilots answer them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower_sim.firmware_parameters import PARAMETER_TYPES, REAL32


class ParameterProtocol:
    """Tells parameters and takes new values.

    PX4 puts an integer's four bytes where the message has a float; ArduPilot converts it to a
    float. PX4 refuses to set a value of another type than the parameter's. Both keep silent about
    a parameter that they do not have.

    Args:
        parameters: by name; altered by PARAM_SET.
        bytewise: PX4's encoding.
        send: sends a message.
    """

    def __init__(
        self, parameters: dict[str, float], bytewise: bool, send: Callable[[Any], None]
    ) -> None:
        self._parameters = parameters
        self._bytewise = bytewise
        self._send = send

    def read(self, m: Any) -> None:
        """Answer PARAM_REQUEST_READ, by index or by name."""
        names = list(self._parameters)
        if 0 <= m.param_index < len(names):
            self._tell(names[m.param_index])
        elif m.param_index == -1:
            self._tell(m.param_id)

    def list(self, _m: Any) -> None:
        """Answer PARAM_REQUEST_LIST."""
        for name in self._parameters:
            self._tell(name)

    def set(self, m: Any) -> None:
        """Take PARAM_SET and tell what holds now."""
        if m.param_id not in self._parameters:
            return
        kind = PARAMETER_TYPES.get(m.param_id, REAL32)
        if not self._bytewise or m.param_type == kind:
            value = self._decoded(m.param_value, kind)
            if math.isfinite(value):
                self._parameters[m.param_id] = value
        self._tell(m.param_id)

    def _tell(self, name: str) -> None:
        if name not in self._parameters:
            return
        kind = PARAMETER_TYPES.get(name, REAL32)
        self._send(
            mavlink.MAVLink_param_value_message(
                name.encode(),
                self._encoded(self._parameters[name], kind),
                kind,
                len(self._parameters),
                list(self._parameters).index(name),
            )
        )

    def _encoded(self, value: float, kind: int) -> float:
        if not self._bytewise or kind == REAL32:
            return value
        return float(struct.unpack("<f", struct.pack("<i", round(value)))[0])

    def _decoded(self, carried: float, kind: int) -> float:
        if kind == REAL32:
            return carried
        if not self._bytewise:
            return float(round(carried)) if math.isfinite(carried) else carried
        return float(struct.unpack("<i", struct.pack("<f", carried))[0])
