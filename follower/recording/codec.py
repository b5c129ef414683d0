"""Dataclasses to JSON and back, without losing a bit.

A float is written by Python's `repr`, from which the very same float is read again. JSON knows no
NaN and no infinity: they are written as the strings "NaN", "Infinity" and "-Infinity". What is
None is left out.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from enum import Enum
from functools import cache
from typing import Any, TypeVar

import numpy as np

from follower.recorder.fields import SHAPES, Field, fields_of

T = TypeVar("T")
_Convert = Callable[[Any], Any]
_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"), ensure_ascii=False)


def encode(record: object) -> bytes:
    """Return a dataclass as JSON, UTF-8."""
    kind: type = type(record)
    plain = _encoder(kind)(record)
    try:
        return _JSON.encode(plain).encode()
    except ValueError:
        return _JSON.encode(_spelt(plain)).encode()


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
