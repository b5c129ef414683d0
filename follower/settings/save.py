"""Writes changed settings back into the user's file, whose comments and order stay."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from follower.settings.settings import Settings, nested
from follower_control.common.strict_config import SettingsError, merged, parse

_CRLF = "\r\n"


def save_settings(path: Path, values: Mapping[str, Any]) -> None:
    """Set values by their paths ("servo.azimuth.kp") in a settings file, whole or not at all.

    A link stays one: what it leads to is written. So do the ends of lines.

    Raises:
        SettingsError: the file cannot be read, written or edited, or would not be valid then.
    """
    try:
        path = path.resolve()
        data = path.read_bytes().decode("utf-8")
        before = data.replace(_CRLF, "\n")
        after = with_values(before, values)
        parse(Settings, yaml.safe_load(after), str(path))
        if after != before:
            _replace(path, after.replace("\n", _CRLF) if _CRLF in data else after)
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise SettingsError(f"{path}: cannot be saved: {reason}") from None


def with_values(text: str, values: Mapping[str, Any]) -> str:
    """Return YAML text in which these paths have these values; all else stays to the letter.

    Raises:
        SettingsError: the text is too unusual to be edited without changing something else.
    """
    try:
        wanted = yaml.safe_load(text) or {}
        for path, value in values.items():
            wanted = merged(wanted, nested(path.split("."), value))
            text = _with_value(text, path.split("."), _scalar(value))
        fits = yaml.safe_load(text) == wanted
    except (yaml.YAMLError, AttributeError, TypeError) as error:
        raise SettingsError(f"the file cannot be edited: {' '.join(str(error).split())}") from None
    if not fits:
        raise SettingsError("the file is written in a way that cannot be edited; edit it by hand")
    return text


def _with_value(text: str, path: list[str], scalar: str) -> str:
    node, left = yaml.compose(text, yaml.SafeLoader), list(path)
    if node is None:
        return text + _block(left, scalar, 0) + "\n"
    while left and isinstance(node, yaml.MappingNode):
        inner = next((value for key, value in node.value if key.value == left[0]), None)
        if inner is None:
            return _added(text, node, left, scalar)
        node, left = inner, left[1:]
    start, end = node.start_mark.index, node.end_mark.index
    if left and node.tag != "tag:yaml.org,2002:null":
        raise SettingsError(f"{'.'.join(path)}: there is something else in its place")
    if left:  # a section without anything in it
        indent = node.start_mark.column
        line = text.rfind("\n", 0, start) + 1
        depth = len(text[line:]) - len(text[line:].lstrip(" ")) if indent else 0
        return f"{text[:start]}\n{_block(left, scalar, depth + 2)}{text[end:]}"
    return text[:start] + scalar + text[end:]


def _added(text: str, node: yaml.MappingNode, path: list[str], scalar: str) -> str:
    """Return the text with one more entry at the end of a mapping."""
    if node.flow_style:
        end = node.end_mark.index - 1
        flow = scalar
        for key in reversed(path[1:]):
            flow = f"{{{key}: {flow}}}"
        comma = ", " if node.value else ""
        return f"{text[:end].rstrip()}{comma}{path[0]}: {flow}{text[end:]}"
    last: yaml.Node = node
    while isinstance(last, yaml.MappingNode) and last.value and not last.flow_style:
        last = last.value[-1][1]
    line_end = text.find("\n", last.end_mark.index)
    line_end = len(text) if line_end < 0 else line_end
    block = _block(path, scalar, node.start_mark.column)
    return f"{text[:line_end]}\n{block}{text[line_end:]}"


def _block(path: list[str], scalar: str, indent: int) -> str:
    lines = [f"{' ' * (indent + 2 * depth)}{key}:" for depth, key in enumerate(path)]
    return "\n".join(lines) + f" {scalar}"


def _scalar(value: Any) -> str:
    return yaml.safe_dump(value).removesuffix("\n").removesuffix("...").strip()


def _replace(path: Path, text: str) -> None:
    """Write the whole file, or leave it as it was."""
    temporary = path.with_name(f".{path.name}.part")
    with temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    temporary.chmod(path.stat().st_mode & 0o7777)
    temporary.replace(path)
