"""Dataclasses to JSON and back, without losing a bit.

A float is written by Python's `repr`, from which the very same float is read again. JSON knows no
NaN and no infinity: they are written as the strings "NaN", "Infinity" and "-Infinity". What is
None is left out.

What a message's dataclass says about its fields: kind, unit and meaning.

The types come from the annotations, the units from the names (as everywhere in this project), the
meanings from the "Attributes:" of the docstring. So the dataclass is the only place to change.
"""

import dataclasses
import inspect
import json
import math
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, TypeVar

import numpy as np

from follower.recording.messages import MessageKind
from follower.settings.field_docs import meanings, unit_of, without_none

SHAPES: Mapping[str, tuple[int, ...]] = {"covariance": (6, 6), "turn": (3, 3), "place_m": (3,)}
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


def _field(name: str, hint: Any, says: str) -> Field:
    inner, optional = without_none(hint)
    origin = typing.get_origin(inner)
    is_list = origin is tuple
    element = typing.get_args(inner)[0] if is_list else origin or inner
    if not isinstance(element, type):
        raise TypeError(f"{name}: {hint} cannot be recorded")
    return Field(name, element, is_list, optional, unit_of(name), says)


T = TypeVar("T")
_Convert = Callable[[Any], Any]
_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"), ensure_ascii=False)


def encode(record: object) -> bytes:
    """Return a dataclass as JSON, UTF-8."""
    kind: type = type(record)
    plain = _encoder(kind)(record)
    try:
        text = _JSON.encode(plain)
    except ValueError:
        text = _JSON.encode(_spelt(plain))
    return text.encode("utf-8", "replace")  # a file's name may be no UTF-8


def decode(kind: type[T], data: bytes) -> T:
    """Return the dataclass that was encoded.

    Fields that are missing take their defaults and unknown ones are passed over, so that logs of
    other versions of the program can be read.

    Raises:
        ValueError: the data does not fit; the message says where.
    """
    try:
        record: type = kind
        convert: Callable[[Any], T] = _decoder(record)
        return convert(json.loads(data))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{kind.__name__}: {error!r} in {data[:60]!r}") from error


@cache
def _encoder(record: type) -> _Convert:
    parts = tuple((field.name, _to_plain(field)) for field in fields_of(record))

    def convert(value: Any) -> dict[str, Any]:
        found = ((name, to_plain, getattr(value, name)) for name, to_plain in parts)
        return {name: to_plain(part) for name, to_plain, part in found if part is not None}

    return convert


def _to_plain(field: Field) -> _Convert:
    if field.kind is np.ndarray:
        return lambda array: array.ravel().tolist()
    one = _encoder(field.kind) if dataclasses.is_dataclass(field.kind) else _scalar(field.kind)
    return (lambda many: [one(value) for value in many]) if field.is_list else one


def _scalar(kind: type) -> _Convert:
    return str if issubclass(kind, Enum) else kind


def _spelt(plain: Any) -> Any:
    if isinstance(plain, dict):
        return {key: _spelt(value) for key, value in plain.items()}
    if isinstance(plain, list):
        return [_spelt(value) for value in plain]
    if isinstance(plain, float) and not math.isfinite(plain):
        return "NaN" if math.isnan(plain) else "Infinity" if plain > 0 else "-Infinity"
    return plain


@cache
def _decoder(record: type) -> _Convert:
    parts = tuple((field.name, _from_plain(field), field.optional) for field in fields_of(record))
    defaulted = {
        field.name
        for field in dataclasses.fields(record)
        if field.default is not dataclasses.MISSING
        or field.default_factory is not dataclasses.MISSING
    }

    def convert(plain: Any) -> Any:
        values: dict[str, Any] = {}
        for name, from_plain, optional in parts:
            if name in plain:
                values[name] = from_plain(plain[name])
            elif optional:
                values[name] = None
            elif name not in defaulted:
                raise KeyError(name)
        return record(**values)

    return convert


def _from_plain(field: Field) -> _Convert:
    if field.kind is np.ndarray:
        shape = SHAPES[field.name]
        return lambda flat: np.array([float(value) for value in flat], np.float64).reshape(shape)
    one = _decoder(field.kind) if dataclasses.is_dataclass(field.kind) else field.kind
    return (lambda many: tuple(one(value) for value in many)) if field.is_list else one


_NOT_FINITE = 'A number that is not finite is the string "NaN", "Infinity" or "-Infinity".'


def schema_name(message: MessageKind) -> str:
    """Return the schema's name, e.g. "follower.TrackRecord"."""
    return f"follower.{message.schema or message.record.__name__}"


def json_schema(message: MessageKind) -> dict[str, Any]:
    """Return the JSON schema of a message."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": schema_name(message),
        "description": f"{message.says} {_NOT_FINITE}",
        **_object(message.record),
    }


def _object(record: type) -> dict[str, Any]:
    fields = fields_of(record)
    return {
        "type": "object",
        "properties": {field.name: _described(field) for field in fields},
        "required": [field.name for field in fields if not field.optional],
    }


def _described(field: Field) -> dict[str, Any]:
    unit = f" [{field.unit}]" if field.unit else ""
    text = f"{field.says}{unit}".strip()
    schema = _array(field) if field.is_list or field.kind is np.ndarray else _one(field.kind)
    return {**schema, "description": text} if text else schema


def _array(field: Field) -> dict[str, Any]:
    if field.kind is not np.ndarray:
        return {"type": "array", "items": _one(field.kind)}
    size = int(np.prod(SHAPES[field.name]))
    return {"type": "array", "items": {"type": "number"}, "minItems": size, "maxItems": size}


def _one(kind: type) -> dict[str, Any]:
    if dataclasses.is_dataclass(kind):
        return _object(kind)
    if issubclass(kind, Enum):
        return {"type": "string", "enum": [str(member) for member in kind]}
    names = {bool: "boolean", int: "integer", float: "number", str: "string"}
    return {"type": names[kind]}
