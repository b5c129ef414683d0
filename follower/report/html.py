"""Small pieces of HTML. Whatever comes in as text is escaped here and nowhere else."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

_LONG = 25


@dataclass(frozen=True, slots=True)
class Html:
    """Text that is HTML already and is not escaped again."""

    text: str


Cell = str | Html
_WIDE = 6
"""Tables of so many columns are too wide for a phone."""


def text_of(cell: Cell) -> str:
    """Return a cell's HTML."""
    return cell.text if isinstance(cell, Html) else escape(cell)


def section(title: str, *parts: str) -> str:
    """Return a titled section, "" if there is nothing in it."""
    body = "\n".join(part for part in parts if part)
    return f"<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>" if body else ""


def paragraph(text: str) -> str:
    """Return a paragraph in small print."""
    return f'<p class="quiet">{escape(text)}</p>'


def figure(svg: str, caption: str, kind: str = "") -> str:
    """Return a plot with its caption; the plot scrolls sideways where it has no room."""
    names = f"plot {kind}".strip()
    said = f"<figcaption>{escape(caption)}</figcaption>"
    return f'<figure><div class="{names}">{svg}</div>{said}</figure>'


def table(head: Sequence[Cell], rows: Iterable[Sequence[Cell]], numbers: Sequence[int] = ()) -> str:
    """Return a table, "" without rows; the columns in `numbers` are aligned to the right.

    On a narrow screen a row of many columns is a list, in which each cell has its heading.
    """
    wide = len(head) >= _WIDE and all(isinstance(cell, str) for cell in head)
    named = [text_of(cell) for cell in head] if wide else []
    body = "\n".join(f"<tr>{_cells('td', row, numbers, named)}</tr>" for row in rows)
    if not body:
        return ""
    kind = ' class="wide"' if wide else ""
    return (
        f'<div class="table"><table{kind}>\n'
        f"<thead><tr>{_cells('th', head, numbers)}</tr></thead>\n"
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def folded(summary: str, body: str) -> str:
    """Return something that opens on a click."""
    return f"<details><summary>{escape(summary)}</summary>\n{body}\n</details>"


def folded_if_long(table: str, length: int, rows: str) -> str:
    """Return a table, folded if it has more than 25 rows; `rows` is what the summary calls them."""
    return folded(f"{length} {rows}", table) if length > _LONG else table


def preformatted(text: str) -> str:
    """Return text as it is typed."""
    return f"<pre>{escape(text)}</pre>"


def tiles(pairs: Iterable[tuple[str, str]]) -> str:
    """Return the few figures that a reader looks for first: (name, value)."""
    items = "\n".join(
        f"<li><b>{escape(value)}</b><span>{escape(name)}</span></li>" for name, value in pairs
    )
    return f'<ul class="tiles">\n{items}\n</ul>' if items else ""


def _cells(
    tag: str, cells: Sequence[Cell], numbers: Sequence[int], names: Sequence[str] = ()
) -> str:
    """Return a row's cells, each with the name of its column where there are names."""
    kinds = ['class="number"' if column in numbers else "" for column in range(len(cells))]
    named = [f'data-name="{name}"' for name in names] or [""] * len(cells)
    attributes = (" ".join(filter(None, both)) for both in zip(kinds, named, strict=True))
    return "".join(
        f"<{tag} {more}>{text_of(cell)}</{tag}>" if more else f"<{tag}>{text_of(cell)}</{tag}>"
        for cell, more in zip(cells, attributes, strict=True)
    )
