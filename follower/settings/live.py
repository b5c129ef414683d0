"""Settings that may be changed in flight: which, how far, and as what they are recorded."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, get_type_hints

from follower.settings.field_docs import without_none
from follower.settings.settings import Settings, nested
from follower_control.common.strict_config import SettingsError, merged, parse

_SECTIONS = {
    "servo": None,
    "search": None,
    "envelope": (
        "max_speed_m_s",
        "max_climb_m_s",
        "max_descent_m_s",
        "max_yaw_rate_deg_s",
        "min_height_m",
        "ceiling_m",
        "min_clearance_m",
        "fence_radius_m",
        "min_distance_m",
    ),
    "supervisor": ("coast_s", "search_s", "hold_s"),
}
"""Sections with the keys of them that may change; None is all."""

LIMITS = ("envelope", "supervisor")
"""Sections of what bounds the flight: in flight that can be tightened alone."""
TOLD_RANGE = ("servo.target_size_m", "servo.target_middle_m")
"""What the distance to the target is computed from: it may be made to seem nearer, but not farther,
or the least distance to it would be no limit."""
_SMALLER_IS_SAFER = (
    "target_size_",
    "max_",
    "ceiling_",
    "fence_radius_",
    "coast_",
    "search_",
    "hold_",
)


@dataclass(frozen=True, slots=True)
class SettingChange:
    """One setting's new value, in force from the control step in which it is recorded.

    Attributes:
        key: its path in the settings, such as "servo.azimuth.kp".
        value: as JSON, which keeps every bit of a number.
    """

    key: str
    value: str

    @classmethod
    def of(cls, key: str, value: Any) -> SettingChange:
        """Make one of a plain value.

        Raises:
            SettingsError: the value is no number, text, truth or None.
        """
        plain = value.value if isinstance(value, Enum) else value
        finite = not isinstance(plain, float) or math.isfinite(plain)
        if not finite or not isinstance(plain, bool | int | float | str | None):
            raise SettingsError(f"{key}: {value} is no value for a setting")
        return cls(key, json.dumps(plain))

    @property
    def plain(self) -> float | str | None:
        """The value as a plain number, truth, text or None."""
        value: float | str | None = json.loads(self.value)
        return value


@dataclass(frozen=True, slots=True)
class LiveKey:
    """A setting that may be changed in flight.

    Attributes:
        key: its path, such as "servo.azimuth.kp".
        kind: float, int, bool or an enumeration.
        optional: whether it may be None.
    """

    key: str
    kind: type
    optional: bool


@cache
def live_keys() -> tuple[LiveKey, ...]:
    """Return every setting that may be changed in flight, in the order of the settings."""
    found = []
    for section, names in _SECTIONS.items():
        law = Settings.model_fields[section].annotation
        for one in _leaves(section, law):
            if names is None or one.key.partition(".")[2] in names:
                found.append(one)
    return tuple(found)


def value_at(settings: Settings, key: str) -> Any:
    """Return a setting's value by its path."""
    value: Any = settings
    for part in key.split("."):
        value = getattr(value, part)
    return value


def changed(
    settings: Settings, changes: Iterable[SettingChange], began: Settings | None = None
) -> Settings:
    """Return the settings with these changes, checked as they are when read from a file.

    Args:
        settings: unchanged.
        changes: in their order; they are checked together.
        began: what the flight began with. Given that, a limit of the envelope may be tightened,
            or one of the supervisor's times, and loosened again no further than it was then; nor
            can the target be made to seem farther away.

    Raises:
        SettingsError: a key may not be changed in flight, or a value cannot be used.
    """
    allowed = {one.key for one in live_keys()}
    data: dict[str, Any] = settings.model_dump(mode="json")
    for change in changes:
        if change.key not in allowed:
            raise SettingsError(f"{change.key} cannot be changed in flight")
        data = merged(data, nested(change.key.split("."), json.loads(change.value)))
    result = parse(Settings, data, "in flight")
    if began is not None:
        _check_limits(result, began, [change.key for change in changes])
    return result


def _check_limits(settings: Settings, began: Settings, keys: Iterable[str]) -> None:
    for key in keys:
        section, _, name = key.partition(".")
        if section not in LIMITS and key not in TOLD_RANGE:
            continue
        value, before = value_at(settings, key), value_at(began, key)
        if key in TOLD_RANGE and before is None and value is not None:
            raise SettingsError(
                f"{key} was not given at the start, and is not set in flight: a target could be "
                "made to seem farther away"
            )
        if not _is_as_tight(name, value, before):
            shown = "none" if value is None else format(value, "g")
            may = (
                "a target may be made to seem nearer than that, not farther away by"
                if key in TOLD_RANGE
                else "it may be tightened, not loosened beyond that to"
            )
            raise SettingsError(f"{key} was {before:g} at the start; in flight {may} {shown}")


def _is_as_tight(name: str, value: float | None, before: float | None) -> bool:
    if before is None:
        return True
    if value is None:
        return False
    return value <= before if name.startswith(_SMALLER_IS_SAFER) else value >= before


def _leaves(prefix: str, law: Any) -> Iterator[LiveKey]:
    hints = get_type_hints(law)
    for field in dataclasses.fields(law):
        kind, optional = without_none(hints[field.name])
        key = f"{prefix}.{field.name}"
        if dataclasses.is_dataclass(kind):
            yield from _leaves(key, kind)
        elif isinstance(kind, type) and issubclass(kind, float | int | Enum):
            yield LiveKey(key, kind, optional)
