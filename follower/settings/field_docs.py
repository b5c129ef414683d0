"""What a message's dataclass says about its fields: kind, unit and meaning.

The types come from the annotations, the units from the names (as everywhere in this project), the
meanings from the "Attributes:" of the docstring. So the dataclass is the only place to change.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

_UNITS_BY_NAME = {
    "log_scale_rate_s": "1/s",
    **dict.fromkeys(("cx", "cy", "width", "height"), "px"),
}
_UNITS_BY_ENDING = (
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_px", "px"),
    ("_hz", "Hz"),
    ("_m", "m"),
    ("_us", "µs"),
    ("_s", "s"),
)
SHAPES: Mapping[str, tuple[int, ...]] = {"covariance": (6, 6)}
"""Arrays are written as flat lists, row by row; these are their shapes."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message.

    Attributes:
        name: its key.
        kind: the Python type, of one element if it is a list.
        is_list: whether it is a list of them.
        optional: whether it may be missing, which stands for None.
        unit: its unit, "" if it has none.
        says: its meaning.
    """

    name: str
    kind: type
    is_list: bool
    optional: bool
    unit: str
    says: str


@cache
def fields_of(record: type) -> tuple[Field, ...]:
    """Return the fields of a dataclass.

    Raises:
        TypeError: an annotation is of a kind that cannot be recorded.
    """
    hints = typing.get_type_hints(record)
    says = meanings(inspect.getdoc(record) or "")
    return tuple(
        _field(field.name, hints[field.name], says.get(field.name, ""))
        for field in dataclasses.fields(record)
    )


def unit_of(name: str) -> str:
    """Return the unit that a field's name stands for, "" if it has none."""
    if name in _UNITS_BY_NAME:
        return _UNITS_BY_NAME[name]
    return next((unit for ending, unit in _UNITS_BY_ENDING if name.endswith(ending)), "")


def _field(name: str, hint: Any, says: str) -> Field:
    inner, optional = _without_none(hint)
    element, is_list = _element(inner)
    if not isinstance(element, type):
        raise TypeError(f"{name}: {hint} cannot be recorded")
    return Field(name, element, is_list, optional, unit_of(name), says)


def _without_none(hint: Any) -> tuple[Any, bool]:
    if typing.get_origin(hint) not in (types.UnionType, typing.Union):
        return hint, False
    others = [part for part in typing.get_args(hint) if part is not type(None)]
    if len(others) != 1:
        raise TypeError(f"{hint} cannot be recorded: one type, or that or None")
    return others[0], True


def _element(hint: Any) -> tuple[Any, bool]:
    origin = typing.get_origin(hint)
    if origin is np.ndarray:
        return np.ndarray, False
    if origin is tuple:
        return typing.get_args(hint)[0], True
    return hint, False


def meanings(docstring: str) -> dict[str, str]:
    """Return name → meaning from a Google-style "Attributes:" section."""
    _, _, section = docstring.partition("Attributes:\n")
    found: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        start = re.match(r"    (\w+(?:, \w+)*): (.*)", line)
        if start is not None:
            names = start[1].split(", ")
            found.update(dict.fromkeys(names, start[2]))
        elif line.startswith("        "):
            found.update({name: f"{found[name]} {line.strip()}" for name in names})
        else:
            names = []
    return found
