"""What a message's dataclass says about its fields: kind, unit and meaning.

The types come from the annotations, the units from the names (as everywhere in this project), the
meanings from the "Attributes:" of the docstring or from below the field. So the dataclass is the
only place to change.
"""

import ast
import dataclasses
import inspect
import operator
import re
import textwrap
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from enum import StrEnum
from functools import cache
from itertools import pairwise
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import yaml
from pydantic import BaseModel
from pydantic_core import to_jsonable_python

_WIDTH = 98
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


@cache
def _said_of(section: type) -> dict[str, str]:
    """Return name → meaning, from a class's docstring and from the strings below its fields.

    Python's None is called null, which is what has to be written into a file or after `--set`.
    """
    found = meanings(inspect.getdoc(section) or "")
    with suppress(OSError, TypeError):  # installed without sources; or no class of Python's
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(section))).body
        for field, below in pairwise(tree.body if isinstance(tree, ast.ClassDef) else ()):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                found[ast.unparse(field.target)] = " ".join(ast.literal_eval(below.value).split())
    return {name: re.sub(r"\bNone\b", "null", meaning) for name, meaning in found.items()}


def setting_meaning(settings: object, key: str) -> str:
    """Return what a setting's section says about it, "" if nothing.

    Args:
        settings: that have the key.
        key: path of the setting, such as "servo.azimuth.kp".
    """
    kind, name = _holder(settings, key)
    return _said_of(kind).get(name, "")


def _holder(settings: object, key: str) -> tuple[Any, str]:  # mypy: no type is hashable
    """Return the section that has a setting, and the setting's name in it."""
    section, _, name = key.rpartition(".")
    return type(operator.attrgetter(section)(settings) if section else settings), name


def _explained_setting(settings: object, key: str) -> str:
    """Return what a setting means, and what it may be where that is one of a few words."""
    kind, name = _holder(settings, key)
    meaning = _said_of(kind).get(name, "")
    words = _words(get_type_hints(kind).get(name))
    named = all(re.search(rf"\b{re.escape(word)}\b", meaning) for word in words)
    return meaning if named else f"{meaning} ({' | '.join(words)})"


def explained_yaml(settings: object, text: str) -> str:
    """Return settings as YAML, and above each its meaning and the words it may be.

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
                meaning = _explained_setting(settings, ".".join(path))
            except AttributeError:  # a mapping's own keys
                meaning = ""
            indent = f"{key[1]}# "
            lines += textwrap.wrap(meaning, _WIDTH, initial_indent=indent, subsequent_indent=indent)
        lines.append(line)
    return "\n".join(lines) + "\n"


_KINDS = {float: "number", int: "whole number", str: "text", bool: "true or false"}
_BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


@dataclass(frozen=True, slots=True)
class _Key:
    """A key of a section: what may stand there, and what does if it is left out."""

    name: str
    hint: Any
    meaning: str
    default: Any = None
    is_required: bool = False

    @property
    def section(self) -> type | None:
        """The section below it, which may be one of a list; None if it has a value of its own."""
        hint, _ = without_none(_plain(self.hint))
        inner = _plain(get_args(hint)[0]) if get_origin(hint) is list else hint
        is_model = inspect.isclass(inner) and issubclass(inner, BaseModel)
        return inner if is_model or is_dataclass(inner) else None

    @property
    def is_list(self) -> bool:
        """Whether there may be several."""
        return get_origin(without_none(_plain(self.hint))[0]) is list


def explained_keys(section: type, indent: str = "") -> str:
    """Return all keys of a section as YAML with the defaults, and above each what it means.

    A key without a default has no value; a list of sections has one, as an example.

    Args:
        section: a pydantic model or a dataclass.
        indent: what each line begins with.
    """
    return "".join(f"{line}\n" for key in _keys(section) for line in _explained(key, indent))


def _explained(key: _Key, indent: str) -> Iterator[str]:
    kind = "" if key.section else _kind(key.hint)
    if key.section and key.is_list:
        kind = "list"
    elif key.section and key.default is None and not key.is_required:
        kind = "none if left out"
    said = ", ".join(filter(None, (kind, "required" if key.is_required else "")))
    text = f"{key.meaning} ({said})" if said else key.meaning
    start = f"{indent}# "
    yield from textwrap.wrap(text.strip(), _WIDTH, initial_indent=start, subsequent_indent=start)
    if key.section is None:
        yield f"{indent}{key.name}: {'' if key.is_required else _flow(key.default)}".rstrip()
        return
    yield f"{indent}{key.name}:"
    if key.is_list:
        yield f"{indent}  -"
    deeper = "    " if key.is_list else "  "
    yield explained_keys(key.section, indent + deeper).rstrip("\n")


def _keys(section: Any) -> Iterator[_Key]:
    said = _said_of(section)
    hints = get_type_hints(section, include_extras=True)
    if issubclass(section, BaseModel):
        for name, field in section.model_fields.items():
            default = None if field.is_required() else field.get_default(call_default_factory=True)
            yield _Key(name, hints[name], said.get(name, ""), default, field.is_required())
        return
    for one in dataclasses.fields(section):
        default = None if one.default is dataclasses.MISSING else one.default
        if one.default_factory is not dataclasses.MISSING:
            default = one.default_factory()
        required = one.default is one.default_factory is dataclasses.MISSING
        yield _Key(one.name, hints[one.name], said.get(one.name, ""), default, required)


def _kind(hint: Any) -> str:
    """Return in words what may stand where this type is asked for."""
    if get_origin(hint) is Annotated:
        return " ".join((_kind(get_args(hint)[0]), *_bounds(hint.__metadata__)))
    parts = get_args(hint)
    if words := _words(hint):
        return " | ".join(words)
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(map(_kind, parts))
    if get_origin(hint) is list:
        return f"list of {_kind(parts[0])}"
    if get_origin(hint) is tuple:
        return f"[{', '.join(map(_kind, parts))}]"
    if get_origin(hint) is dict:
        return "keys and values"
    return "null" if hint is NoneType else _KINDS.get(hint, hint.__name__)


def _words(hint: Any) -> tuple[str, ...]:
    """Return the words of which one has to stand there, if only a few may."""
    if get_origin(hint) is Literal:
        return tuple(map(str, get_args(hint)))
    return tuple(hint) if inspect.isclass(hint) and issubclass(hint, StrEnum) else ()


def _bounds(metadata: Iterable[Any]) -> Iterator[str]:
    """Yield the limits that pydantic's annotations set."""
    for one in metadata:
        for bound in (one, *getattr(one, "metadata", ())):
            for name, word in _BOUNDS.items():
                if getattr(bound, name, None) is not None:
                    yield f"{word} {getattr(bound, name):g}"


def _plain(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def _flow(value: Any) -> str:
    """Return a value as YAML in one line."""
    text = yaml.safe_dump(to_jsonable_python(value), default_flow_style=True, width=1000)
    return text.removesuffix("\n").removesuffix("\n...")


def without_none(hint: Any) -> tuple[Any, bool]:
    """Return the type in "that type or None", and whether it is such a union."""
    if get_origin(hint) not in (Union, UnionType):
        return hint, False
    others = [part for part in get_args(hint) if part is not type(None)]
    return (others[0] if len(others) == 1 else hint), True
