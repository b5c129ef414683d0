"""Reads some of the autopilot's parameters."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping

from pymavlink.dialects.v20 import common as mavlink

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
    """Says which names to ask for and when, and keeps the answers; it sends nothing itself.

    A name that stays unanswered is asked for six times in all, 0.6 s apart, a few names at once so
    that a slow radio is not flooded.

    Args:
        bytewise: integers come as their bytes, as PX4 sends them; else as floats.
    """

    def __init__(self, bytewise: bool) -> None:
        self._bytewise = bytewise
        self._values: dict[str, float] = {}
        self._tries: dict[str, int] = {}
        self._asked_s: dict[str, float] = {}

    @property
    def values(self) -> Mapping[str, float]:
        """What was told so far, by name."""
        return dict(self._values)

    @property
    def missing(self) -> frozenset[str]:
        """What was asked for in vain."""
        return frozenset(n for n, tries in self._open().items() if tries >= _TRIES)

    @property
    def done(self) -> bool:
        """Whether everything was told or asked for in vain."""
        return all(tries >= _TRIES for tries in self._open().values())

    def want(self, names: Iterable[str]) -> None:
        """Have these read, too."""
        for name in names:
            self._tries.setdefault(name, 0)

    def due(self, now_s: float) -> list[str]:
        """Return the names to ask for now; they count as asked."""
        names = [name for name, tries in self._open().items() if tries < _TRIES]
        due = [n for n in names if now_s - self._asked_s.get(n, -math.inf) >= _RETRY_S - _EARLY_S]
        for name in due[:_AT_ONCE]:
            self._asked_s[name] = now_s
            self._tries[name] += 1
        return due[:_AT_ONCE]

    def take(self, name: str, carried: float, kind: int) -> None:
        """Take a PARAM_VALUE; what was not asked for and what is no number is left out."""
        value = self._decoded(carried, kind)
        if name in self._tries and math.isfinite(value):
            self._values[name] = value

    def _open(self) -> dict[str, int]:
        return {n: tries for n, tries in list(self._tries.items()) if n not in self._values}

    def _decoded(self, carried: float, kind: int) -> float:
        form = _INTEGERS.get(kind)
        if form is None or not self._bytewise:
            return carried
        return float(struct.unpack(form, struct.pack("<f", carried))[0])
