"""A hook for MkDocs: every class, function and field of the Python API page is documented.

mkdocstrings leaves out what has no docstring, without a word. This looks up what the page names and
warns of each public part without one; `mkdocs build --strict` ends at a warning.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import griffe

PAGE = "reference/python-api.md"
ROOTS = (".", "vision", "control", "sim")
OF_PYDANTIC = "model_config"
NAMED = re.compile(r"^::: (\S+)", re.MULTILINE)
LOG = logging.getLogger("mkdocs.hooks.public_docstrings")


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> None:
    """Warn of what the API page names and nothing documents; called by MkDocs for each page."""
    if page.file.src_uri != PAGE:
        return
    root = Path(config.config_file_path).parent
    for path in undocumented(NAMED.findall(markdown), root):
        LOG.warning("%s has no docstring", path)


def undocumented(names: list[str], root: Path) -> Iterator[str]:
    """Yield the dotted paths of public objects without documentation.

    Raises:
        FileNotFoundError: there is no such module.
    """
    for name in names:
        module, _, member = name.rpartition(".")
        yield from _missing(_visited(module, root)[member])


def _visited(module: str, root: Path) -> griffe.Module:
    """Read one file; all of a package would take ten seconds."""
    for part in ROOTS:
        file = root / part / (module.replace(".", "/") + ".py")
        if file.exists():
            code = file.read_text("utf-8")
            return griffe.visit(module, file, code, docstring_parser=griffe.Parser("google"))
    raise FileNotFoundError(f"{PAGE}: there is no module {module}")


def _missing(thing: griffe.Object | griffe.Alias) -> Iterator[str]:
    if not thing.has_docstring:
        yield thing.path
    if not thing.is_class:
        return
    fields = _described_fields(thing)
    for member in thing.members.values():
        if member.name.startswith("_") or member.name in {*fields, OF_PYDANTIC}:
            continue
        if not member.has_docstring:
            yield member.path


def _described_fields(thing: griffe.Object | griffe.Alias) -> set[str]:
    """Return the fields that a class docstring describes under `Attributes:`."""
    sections = thing.docstring.parsed if thing.docstring else []
    return {
        field.name
        for section in sections
        if section.kind is griffe.DocstringSectionKind.attributes
        for field in section.value
    }
