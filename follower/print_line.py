"""Lines for people as they are: paths and commands in them stay whole, and can be copied."""

from __future__ import annotations

from rich.console import Console


def print_line(console: Console, text: str, style: str | None = None) -> None:
    """Print a line. It is not wrapped, and brackets in it are brackets, not styles."""
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)
