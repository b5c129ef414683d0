"""JSON schemas of the messages."""

from __future__ import annotations

import dataclasses
from enum import Enum
from typing import Any

import numpy as np

from follower.recorder.fields import SHAPES, Field, fields_of
from follower.recorder.messages import Message

_NOT_FINITE = 'A number that is not finite is the string "NaN", "Infinity" or "-Infinity".'


def schema_name(message: Message) -> str:
    """Return the schema's name, e.g. "follower.TrackRecord"."""
    return f"follower.{message.record.__name__}"


def json_schema(message: Message) -> dict[str, Any]:
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
