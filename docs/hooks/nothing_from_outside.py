"""A hook for MkDocs: no page of the site loads anything from elsewhere.

Links that a reader follows may lead outside; scripts, styles, images, fonts and frames may not. A
page that loads one is a warning, at which `mkdocs build --strict` ends.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

LOG = logging.getLogger("mkdocs.hooks.nothing_from_outside")
FOLLOWED = {"a", "area"}
"""Elements whose address is only followed by a reader."""
NAMES_ONLY = {"canonical", "prev", "next", "author", "license"}
"""Kinds of <link> that load nothing."""


def on_post_build(config: Any, **_: Any) -> None:
    """Warn of each address outside that a page loads; called by MkDocs when all is written."""
    site = Path(config.site_dir)
    for page in sorted(site.rglob("*.html")):
        for address in loaded_from_outside(page.read_text("utf-8")):
            LOG.warning("%s loads %s", page.relative_to(site), address)
    for style in sorted(site.rglob("*.css")):
        if "url(http" in style.read_text("utf-8").replace('"', "").replace("'", ""):
            LOG.warning("%s loads from outside", style.relative_to(site))


def loaded_from_outside(html: str) -> Iterator[str]:
    """Yield the addresses with a host that a browser fetches to show this page."""
    reader = _Reader()
    reader.feed(html)
    yield from (one for one in reader.loaded if one.startswith(("http:", "https:", "//")))


class _Reader(HTMLParser):
    """Gathers what a page's elements load."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag in FOLLOWED or values.get("rel") in NAMES_ONLY:
            return
        self.loaded += [values.get(key) or "" for key in ("src", "href", "data", "poster")]
