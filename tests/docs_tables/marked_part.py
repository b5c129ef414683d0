"""The part of a page that a program writes, between two marks."""

from __future__ import annotations


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
