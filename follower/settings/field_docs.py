"""What a message's dataclass says about its fields: kind, unit and meaning.

The types come from the annotations, the units from the names (as everywhere in this project), the
meanings from the "Attributes:" of the docstring. So the dataclass is the only place to change.
"""

import inspect
import operator
import re
import textwrap
from types import UnionType
from typing import Any, Union, get_args, get_origin

_UNITS_BY_NAME = {
    "log_scale_rate_s": "1/s",
    **dict.fromkeys(("cx", "cy", "width", "height"), "px"),
}
_UNITS_BY_ENDING = (
    ("_rad_s", "rad/s"),
    ("_deg_s2", "°/s²"),
    ("_deg_s", "°/s"),
    ("_m_s3", "m/s³"),
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_deg", "°"),
    ("_px", "px"),
    ("_hz", "Hz"),
    ("_m", "m"),
    ("_us", "µs"),
    ("_s", "s"),
)


def unit_of(name: str) -> str:
    """Return the unit that a field's name stands for, "" if it has none."""
    if name in _UNITS_BY_NAME:
        return _UNITS_BY_NAME[name]
    return next((unit for ending, unit in _UNITS_BY_ENDING if name.endswith(ending)), "")


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


def setting_meaning(settings: object, key: str) -> str:
    """Return what the docstring of a setting's section says about it, "" if nothing.

    Args:
        settings: that have the key.
        key: path of the setting, such as "servo.azimuth.kp".
    """
    section, _, name = key.rpartition(".")
    holder = operator.attrgetter(section)(settings) if section else settings
    return meanings(inspect.getdoc(holder) or "").get(name, "")


def explained_yaml(settings: object, text: str) -> str:
    """Return settings as YAML with each one's meaning above it.

    Args:
        settings: what the text says.
        text: block style, two spaces a level.
    """
    lines, path = list[str](), list[str]()
    for line in text.splitlines():
        key = re.match(r"((?:  )*)(\w+):", line)
        if key is not None:
            path[len(key[1]) // 2 :] = [key[2]]
            try:
                meaning = setting_meaning(settings, ".".join(path))
            except AttributeError:  # a mapping's own keys
                meaning = ""
            indent = f"{key[1]}# "
            lines += textwrap.wrap(meaning, 98, initial_indent=indent, subsequent_indent=indent)
        lines.append(line)
    return "\n".join(lines) + "\n"


def without_none(hint: Any) -> tuple[Any, bool]:
    """Return the type in "that type or None", and whether it is such a union."""
    if get_origin(hint) not in (Union, UnionType):
        return hint, False
    others = [part for part in get_args(hint) if part is not type(None)]
    return (others[0] if len(others) == 1 else hint), True
