"""The part of a page that a program writes, between two marks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


@dataclass(frozen=True)
class MarkedPart:
    """A page's part that follows from the code alone.

    Attributes:
        page: below docs/.
        name: in the marks.
        text: returns what stands between them.
    """

    page: str
    name: str
    text: Callable[[], str]

    def now(self) -> str:
        """Return the page as it is."""
        return (DOCS / self.page).read_text("utf-8")

    def renewed(self) -> str:
        """Return the page with its part made anew."""
        begin, end = f"<!-- {self.name}: begin -->", f"<!-- {self.name}: end -->"
        return with_part(self.now(), begin, end, self.text())

    def renew(self) -> None:
        """Write the page anew."""
        (DOCS / self.page).write_text(self.renewed(), "utf-8")


def with_part(page: str, begin: str, end: str, text: str) -> str:
    """Return a page with another text between the lines `begin` and `end`.

    Raises:
        ValueError: a mark is missing, or they stand the wrong way round.
    """
    before, first, rest = page.partition(begin)
    _, last, after = rest.partition(end)
    if not first or not last:
        raise ValueError(f"the page lacks {begin} or, behind it, {end}")
    return f"{before}{begin}\n{text}\n{end}{after}"
