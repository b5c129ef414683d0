"""YAML into settings, strictly: what is mistyped is refused, in one line that helps."""

import dataclasses
import difflib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_args, get_origin, get_type_hints

import yaml
from pydantic import BaseModel, ValidationError

ModelT = TypeVar("ModelT", bound=BaseModel)

_ODD_NUMBER = re.compile(r"[-+]?0[0-9_]|.*:")
_NO_SECTION = ("model_type", "dataclass_type", "dict_type", "model_attributes_type")
_NO_NUMBER = ("float_parsing", "float_type", "int_parsing", "int_type")
_UNITS = {
    "_m": "metres",
    "_s": "seconds",
    "_hz": "hertz",
    "_px": "pixels",
    "_deg": "degrees",
    "_m_s": "metres a second",
    "_m_s2": "metres a second squared",
    "_m_s3": "metres a second cubed",
    "_deg_s": "degrees a second",
    "_deg_s2": "degrees a second squared",
}


class SettingsError(ValueError):
    """Settings cannot be used; the message is one line that says where and why.

    Examples:
        >>> import follower
        >>> try:
        ...     follower.load_settings(overrides=["servo.distance=12"])
        ... except follower.SettingsError as error:
        ...     print(error)
        --set servo.distance=12: unknown key 'servo.distance'; did you mean 'distance_m'?
    """


class StrictFields:
    """Base of a settings dataclass: pydantic refuses a key that it has no field for."""

    __slots__ = ()
    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}


def check_ranges(settings: object, **ranges: tuple[float, float]) -> None:
    """Refuse a setting that lies outside its range or is NaN; one that is None is not checked.

    Args:
        settings: has an attribute of each name.
        ranges: smallest and largest value of each, in the setting's own unit.

    Raises:
        ValueError: names the setting, its range and its value.
    """
    for name, (low, high) in ranges.items():
        value = getattr(settings, name)
        if value is not None and not low <= value <= high:
            raise ValueError(f"{name} lies between {low:g} and {high:g}, not {value:g}")


def check_positive(settings: object, *names: str) -> None:
    """Refuse a setting that is not a finite number above 0; one that is None is not checked.

    Raises:
        ValueError: names the setting and its value.
    """
    for name in names:
        value = getattr(settings, name)
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"{name} is finite and positive, not {value:g}")


class _Loader(yaml.SafeLoader):
    """Refuses what YAML 1.1 reads without a word otherwise than it looks.

    A key that stands twice, whose first values would be lost; and numbers like 030 and 1:30, which
    it takes for octal (24) and for base 60 (90).
    """

    def construct_yaml_int(self, node: Any) -> int:
        if _ODD_NUMBER.match(node.value):
            said = f"{node.value} could mean several numbers; write it without leading 0 or colon"
            raise yaml.constructor.ConstructorError(None, None, said, node.start_mark)
        return int(super().construct_yaml_int(node))

    def construct_yaml_float(self, node: Any) -> float:
        if ":" in node.value:
            return self.construct_yaml_int(node)
        return float(super().construct_yaml_float(node))

    def compose_mapping_node(self, anchor: Any) -> Any:
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in lines:
                said = f"{key.value!r} stands in line {lines[key.value]} already; put both together"
                raise yaml.composer.ComposerError(None, None, said, key.start_mark)
            lines[key.value] = key.start_mark.line + 1
        return node


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
_Loader.add_constructor("tag:yaml.org,2002:float", _Loader.construct_yaml_float)


def load_yaml(text: str) -> Any:
    """Read YAML of plain values.

    Raises:
        yaml.YAMLError: it is none, or a key stands in a mapping twice.
    """
    return yaml.load(text, _Loader)  # noqa: S506 - it is a safe loader


def read_mapping(path: str | Path) -> dict[str, Any]:
    """Read a YAML file whose top level is a mapping.

    Raises:
        SettingsError: the file is missing, unreadable, no YAML or no mapping.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise SettingsError(f"{path}: cannot be read: {reason}") from None
    try:
        data = load_yaml(text)
    except yaml.YAMLError as error:
        raise SettingsError(f"{path}: no valid YAML: {_yaml_problem(error)}") from None
    if not isinstance(data, dict):
        raise SettingsError(f"{path}: expected a mapping of keys to values")
    return data


def parse(model: type[ModelT], data: dict[str, Any], source: str) -> ModelT:
    """Check `data` against a pydantic model whose sections are models or dataclasses.

    Raises:
        SettingsError: names `source`, the first wrong key and, if it is mistyped, the nearest
            right one.
    """
    try:
        parsed = model.model_validate(data)
    except ValidationError as error:
        raise SettingsError(f"{source}: {_first_error(model, error)}") from None
    for where, truth in _truths_as_numbers(data, parsed, ""):
        raise SettingsError(f"{source}: {_no_number(where, truth)}")
    return parsed


def _truths_as_numbers(given: Any, taken: Any, where: str) -> Iterator[tuple[str, bool]]:
    """Yield what was given as yes or no and taken as 1 or 0, with its key; pydantic allows it."""
    if isinstance(given, dict):
        for key, value in given.items():
            inside = taken.get(key) if isinstance(taken, dict) else getattr(taken, str(key), None)
            yield from _truths_as_numbers(value, inside, f"{where}.{key}")
    elif isinstance(given, list) and isinstance(taken, list | tuple):
        for number, (value, inside) in enumerate(zip(given, taken, strict=False)):
            yield from _truths_as_numbers(value, inside, f"{where}[{number}]")
    elif isinstance(given, bool) and isinstance(taken, int | float) and taken is not given:
        yield where.removeprefix("."), given


def _first_error(model: type[BaseModel], error: ValidationError) -> str:
    """Describe the first error; a mistyped key comes before a missing one."""
    errors = error.errors(include_url=False, include_context=False)
    unknown = ("extra_forbidden", "unexpected_keyword_argument")
    first = min(errors, key=lambda item: item["type"] not in unknown)
    where = _dotted(first["loc"])
    if first["type"] in unknown:
        return f"unknown key {where!r}{_suggestion(model, first['loc'])}"
    if first["type"] in _NO_NUMBER:
        return _no_number(where, first["input"])
    if first["type"] == "int_from_float":
        return f"{where}: {first['input']!r} is no whole number"
    if first["type"] == "missing":
        missing = [_dotted(one["loc"]) for one in errors if one["type"] == "missing"]
        return f"{', '.join(missing)}: missing, and without a default"
    if first["type"] in _NO_SECTION:
        return f"{where}: {first['input']!r} is no section; write its keys below it, indented"
    message = first["msg"].removeprefix("Value error, ")
    return f"{where}: {message}" if where else message


def _no_number(where: str, given: Any) -> str:
    return f"{where}: {given!r} is no number; write one alone{_unit(where)}"


def _unit(key: str) -> str:
    """Return in which unit the key's name says that its value is."""
    names = [name for name in _UNITS if key.endswith(name)]
    return f", in {_UNITS[max(names, key=len)]}" if names else ""


def _yaml_problem(error: yaml.YAMLError) -> str:
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        mark = error.problem_mark
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}"
    return " ".join(str(error).split())


def _dotted(location: Sequence[str | int]) -> str:
    parts = [f"[{part}]" if isinstance(part, int) else f".{part}" for part in location]
    return "".join(parts).removeprefix(".")


def _suggestion(model: type[BaseModel], location: Sequence[str | int]) -> str:
    known = _keys_at(model, location[:-1])
    near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known keys: {', '.join(known)}"


def _keys_at(model: type[BaseModel], location: Sequence[str | int]) -> list[str]:
    """Return the keys that the section at `location` knows."""
    section: Any = model
    is_name = False
    for part in location:
        if isinstance(part, int) or is_name:  # chooses among alike sections
            is_name = False
            continue
        annotation = _fields(section)[part]
        is_name = get_origin(annotation) is dict
        section = _section_of(annotation)
    return list(_fields(section))


def _fields(section: Any) -> dict[str, Any]:
    """Return the fields of a pydantic model or a dataclass with their types."""
    if issubclass(section, BaseModel):
        return {name: field.annotation for name, field in section.model_fields.items()}
    types = get_type_hints(section)
    return {field.name: types[field.name] for field in dataclasses.fields(section)}


def _section_of(annotation: Any) -> Any:
    """Return the section inside list[...], dict[str, ...], `... | None` and the like."""
    if get_origin(annotation) is dict:
        return _section_of(get_args(annotation)[1])
    inner = [_section_of(a) for a in get_args(annotation) if a is not type(None)]
    return inner[0] if inner else annotation


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return `below` with what `above` says instead, section by section."""
    result = dict(below)
    for key, value in above.items():
        known = result.get(key)
        both = isinstance(value, Mapping) and isinstance(known, Mapping)
        result[key] = merged(known, value) if both and known is not None else value
    return result
