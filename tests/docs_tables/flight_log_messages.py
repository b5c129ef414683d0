"""The messages in docs/reference/flight-log.md, from the table of messages.

    python tests/docs_tables/flight_log_messages.py

writes them again between the page's two marks; a test checks that they are up to date.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from enum import Enum
from itertools import groupby

import numpy as np
from marked_part import MarkedPart

from follower.recording.codec import SHAPES, Field, fields_of
from follower.recording.messages import MESSAGES

_WORDS = 8


def messages_markdown() -> str:
    """Return the fields of each message and of each record in them."""
    lines = []
    for one in MESSAGES:
        lines += [f"### {one.topic}", "", f"{one.says.rstrip('.')} ({one.rate}).", ""]
        lines += [*_fields(one.record), ""]
    lines += ["### Records"]
    for record in nested_records():
        lines += ["", f"#### {record.__name__}", "", *_fields(record)]
    return "\n".join(lines)


def nested_records() -> list[type]:
    """Return the dataclasses that occur in messages and are no message of their own."""
    found = [message.record for message in MESSAGES]
    for record in found:
        kinds = dict.fromkeys(field.kind for field in fields_of(record))
        found += [k for k in kinds if dataclasses.is_dataclass(k) and k not in found]
    return found[len(MESSAGES) :]


def _fields(record: type) -> Iterator[str]:
    """Yield a line for each field; neighbours of one kind and meaning share theirs."""
    for about, fields in groupby(fields_of(record), _about):
        names = ", ".join(f"`{field.name}`" for field in fields)
        yield f"- {names}{about}"


def _about(field: Field) -> str:
    """Return what stands behind a field's name: whether it is optional, its kind, its meaning."""
    words = ["optional"] if field.optional else []
    words += [_kind(field)] if _kind(field) else []
    kind = f" ({' '.join(words)})" if words else ""
    says = f": {field.says.rstrip('.')}" if field.says else ""
    return kind + says


def _kind(field: Field) -> str:
    """Return a field's kind in words, "" for a number whose unit ends its name."""
    if field.kind is np.ndarray:
        return "×".join(map(str, SHAPES[field.name])) + " numbers, by rows"
    if dataclasses.is_dataclass(field.kind):
        name = _link(field.kind)
    elif issubclass(field.kind, Enum):
        words = [str(member) for member in field.kind]
        name = "one of: " + ", ".join(words[:_WORDS]) + (", …" if len(words) > _WORDS else "")
    else:
        names = {bool: "boolean", int: "integer", float: "number", str: "text"}
        unit = field.unit.replace("/", "_").replace("²", "2").replace("µ", "u")
        if unit and field.name.endswith(f"_{unit}"):
            return "list" if field.is_list else ""
        name = field.unit or names[field.kind]
    return f"list of {name}" if field.is_list else name


def _link(record: type) -> str:
    """Return a link to the list of a record's fields."""
    topic = next((message.topic for message in MESSAGES if message.record is record), None)
    if topic is not None:
        return f"[{topic}](#{topic.replace('/', '')})"
    return f"[{record.__name__}](#{record.__name__.lower()})"


MESSAGE_LISTS = MarkedPart("reference/flight-log.md", "messages", messages_markdown)

if __name__ == "__main__":
    MESSAGE_LISTS.renew()
