"""The signatures of the Python API, as a checked-in file has them.

    python tests/helpers/public_surface.py

writes the file anew: for a release, when CHANGELOG.md has named what is different.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import griffe

import follower

ROOT = Path(__file__).parents[2]
SURFACE = Path(__file__).with_suffix(".txt")
OF_OBJECT = {"instance-attribute"}
"""Such an attribute's value is how it comes about, and nobody's business."""
HEAD = "# Signatures of `import follower`, version "


def current_surface() -> dict[str, str]:
    """Return the signature of each public name, and of each public member, by dotted name."""
    return dict(line for name in follower.__all__ for line in _lines(name))


def read_surface() -> tuple[str, dict[str, str]]:
    """Return the version of the file, and its signatures."""
    head, *lines = SURFACE.read_text("utf-8").splitlines()
    return head.removeprefix(HEAD), dict(_split(line) for line in lines)


def _split(line: str) -> tuple[str, str]:
    name, _, signature = line.partition(" ")
    return name, signature


def _lines(name: str) -> Iterator[tuple[str, str]]:
    if name == "__version__":
        yield "follower.__version__", ": str"
        return
    module = getattr(follower, name).__module__
    file = Path(sys.modules[module].__file__ or "")
    visited = griffe.visit(module, file, file.read_text("utf-8"))
    yield from _members(f"follower.{name}", visited[name])


def _members(name: str, thing: griffe.Object | griffe.Alias) -> Iterator[tuple[str, str]]:
    if thing.is_function:
        yield name, _signature(thing)
    elif thing.is_attribute:
        value = "" if thing.value is None or thing.labels == OF_OBJECT else f" = {thing.value}"
        yield name, f": {thing.annotation or ''}{value}".strip()
    elif thing.is_class:
        bases = ", ".join(str(base) for base in thing.bases)
        yield name, f"[{bases}] {_constructor(thing)}".strip()
        for member in thing.members.values():
            if not member.name.startswith("_") and member.name != "model_config":
                yield from _members(f"{name}.{member.name}", member)


def _constructor(thing: griffe.Object | griffe.Alias) -> str:
    """Return how an object is made; a dataclass by its fields in their order."""
    if any(str(one.value).startswith("dataclass") for one in thing.decorators):
        fields = [one for one in thing.attributes.values() if "property" not in one.labels]
        return f"({', '.join(one.name for one in fields)})"
    return _signature(thing.members["__init__"]) if "__init__" in thing.members else ""


def _signature(function: griffe.Object | griffe.Alias) -> str:
    parameters, marked = [], False
    for one in function.parameters:
        if one.name == "self":
            continue
        if one.kind is griffe.ParameterKind.keyword_only and not marked:
            parameters.append("*")
            marked = True
        annotation = f": {one.annotation}" if one.annotation is not None else ""
        default = f" = {one.default}" if one.default is not None else ""
        parameters.append(f"{one.name}{annotation}{default}")
    return f"({', '.join(parameters)}) -> {function.returns}"


def main() -> None:
    """Write the file."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    lines = sorted(f"{name} {signature}" for name, signature in current_surface().items())
    SURFACE.write_text("\n".join([HEAD + project["version"], *lines, ""]), "utf-8")


if __name__ == "__main__":
    main()
