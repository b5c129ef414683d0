"""The settings that a page may change, with what a slider needs to know of them."""

from __future__ import annotations

import inspect
import re
from enum import Enum
from typing import Any

from follower.setting_change import LIMITS, LiveKey, live_keys, value_at
from follower.settings import Settings
from follower.station.wire import Message

_UNITS = {
    "_deg_s2": "°/s²",
    "_deg_s": "°/s",
    "_deg": "°",
    "_m_s3": "m/s³",
    "_m_s2": "m/s²",
    "_m_s": "m/s",
    "_hz": "Hz",
    "_px": "px",
    "_m": "m",
    "_s": "s",
}
_LARGER_IS_SAFER = "min_"
_TIMES = 4.0


def setting_list(settings: Settings) -> list[Message]:
    """Return every setting that may be changed in flight: key, value, range, unit and meaning."""
    return [_described(one, settings) for one in live_keys()]


def setting_values(settings: Settings) -> Message:
    """Return their values by key."""
    return {one.key: _plain(value_at(settings, one.key)) for one in live_keys()}


def _described(one: LiveKey, settings: Settings) -> Message:
    value = _plain(value_at(settings, one.key))
    entry: Message = {
        "key": one.key,
        "type": _type_name(one.kind),
        "value": value,
        "unit": next((unit for end, unit in _UNITS.items() if one.key.endswith(end)), ""),
        "about": _about(one.key, settings),
    }
    if issubclass(one.kind, Enum):
        entry["choices"] = [_plain(choice) for choice in one.kind]
    elif isinstance(value, int | float) and one.kind is not bool:
        entry["low"], entry["high"] = _range(one.key, float(value))
    return entry


def _type_name(kind: type) -> str:
    return "choice" if issubclass(kind, Enum) else kind.__name__


def _range(key: str, value: float) -> tuple[float, float]:
    """Return a slider's ends; the settings' own limits are checked when it is moved.

    A limit of the envelope or the supervisor can be tightened in flight, not loosened.
    """
    section, _, name = key.partition(".")
    if section in LIMITS:
        safer_above = name.startswith(_LARGER_IS_SAFER)
        return (value, max(1.0, _TIMES * value)) if safer_above else (0.0, value)
    reach = max(1.0, _TIMES * abs(value))
    return (-reach if value < 0 else 0.0, reach)


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def _about(key: str, settings: Settings) -> str:
    """Return what the docstring of the setting's own law says of it."""
    section, _, name = key.rpartition(".")
    text = inspect.getdoc(value_at(settings, section)) or ""
    found = re.search(rf"^ *{name}: (.+(?:\n {{8,}}.+)*)", text, re.MULTILINE)
    return " ".join(found[1].split()) if found else ""
