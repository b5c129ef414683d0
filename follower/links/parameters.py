"""Reads some of the autopilot's parameters."""

import math
import struct
from collections.abc import Iterable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

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

    Args:
        bytewise: see the attribute.

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
