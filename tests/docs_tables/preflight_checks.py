"""The list of checks in docs/how-to/fly.md, from the table of checks.

    python tests/docs_tables/preflight_checks.py

writes it again between the page's two marks; a test checks that it is up to date.
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import Any

from marked_part import with_part

from follower.apps.preflight.check import BOTH, PreflightCheck
from follower.apps.preflight.checklist import CHECKS

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "fly.md"
BEGIN, END = "<!-- checks: begin -->", "<!-- checks: end -->"


def checks_markdown() -> str:
    """Return a list of each group's checks, those of one autopilot alone apart."""
    lines = []
    for title, checks in groupby(CHECKS, _title):
        lines += ["", f"**{title}**", "", *map(_item, checks)]
    return "\n".join(lines[1:])


def _title(check: PreflightCheck[Any]) -> str:
    only = "" if check.autopilots == BOTH else f" ({', '.join(check.autopilots)})"
    return f"{check.group}{only}"


def _item(check: PreflightCheck[Any]) -> str:
    return f"- `{check.name}`{'' if check.needed else ' (optional)'}: {check.rule}"


def renewed(page: str) -> str:
    """Return the page with its list made anew.

    Raises:
        ValueError: a mark is missing.
    """
    return with_part(page, BEGIN, END, checks_markdown())


def main() -> None:
    """Renew the page."""
    PAGE.write_text(renewed(PAGE.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
