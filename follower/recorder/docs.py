"""The tables of docs/flight-log.md, from the table of messages.

    python -m follower.recorder.docs docs/flight-log.md

writes them anew between the page's two marks; a test sees to it that they are up to date.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from enum import Enum
from pathlib import Path

import numpy as np

from follower.marked_part import with_part
from follower.recorder.fields import SHAPES, Field, fields_of
from follower.recorder.messages import MESSAGES, Message

_WORDS = 8
BEGIN, END = "<!-- messages: begin -->", "<!-- messages: end -->"


def messages_markdown() -> str:
    """Return the table of messages, and for each the table of its fields."""
    lines = ["| topic | comes | says |", "|---|---|---|"]
    lines += [f"| `{one.topic}` | {one.rate} | {one.says} |" for one in MESSAGES]
    for message in MESSAGES:
        lines += ["", *_fields(message)]
    return "\n".join(lines)


def renewed(page: str) -> str:
    """Return the page with its tables made anew.

    Raises:
        ValueError: a mark is missing.
    """
    return with_part(page, BEGIN, END, messages_markdown())


def _fields(message: Message) -> Iterator[str]:
    yield f"### {message.topic}"
    yield ""
    yield "| field | kind | unit | says |"
    yield "|---|---|---|---|"
    for prefix, field in _flat("", message.record):
        optional = ", may be missing" if field.optional else ""
        says = field.says.rstrip(".")
        yield f"| `{prefix}{field.name}` | {_kind(field)}{optional} | {field.unit} | {says} |"


def _flat(prefix: str, record: type) -> Iterator[tuple[str, Field]]:
    """Give the fields of a record with those of the records in it."""
    for field in fields_of(record):
        if dataclasses.is_dataclass(field.kind):
            if field.optional:
                yield prefix, field
            marks = "[]" if field.is_list else ""
            yield from _flat(f"{prefix}{field.name}{marks}.", field.kind)
        else:
            yield prefix, field


def _kind(field: Field) -> str:
    if field.kind is np.ndarray:
        return "×".join(map(str, SHAPES[field.name])) + " numbers, by rows"
    if issubclass(field.kind, Enum):
        words = [str(member) for member in field.kind]
        return "one of: " + ", ".join(words[:_WORDS]) + (", …" if len(words) > _WORDS else "")
    names = {bool: "yes or no", int: "whole number", float: "number", str: "text"}
    name = names.get(field.kind, "object")
    return f"list of {name}s" if field.is_list else name


def main() -> None:
    """Renew the page that the command line names."""
    path = Path(sys.argv[1])
    path.write_text(renewed(path.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
