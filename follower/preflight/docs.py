"""The table of checks in docs/fly.md, from the table itself.

    python -m follower.preflight.docs docs/fly.md

writes it anew between the page's two marks; a test sees to it that it is up to date.
"""

from __future__ import annotations

import sys
from pathlib import Path

from follower.marked_part import with_part
from follower.preflight.check import BOTH, Check
from follower.preflight.table import CHECKS

BEGIN, END = "<!-- checks: begin -->", "<!-- checks: end -->"


def checks_markdown() -> str:
    """Return the table."""
    lines = ["| check | needed | wants |", "|---|---|---|"]
    group = ""
    for check in CHECKS:
        if check.group != group:
            group = check.group
            lines.append(f"| **{group}** | | |")
        lines.append(_row(check))
    return "\n".join(lines)


def _row(check: Check) -> str:
    only = "" if check.autopilots == BOTH else f" ({', '.join(check.autopilots)})"
    return f"| `{check.name}`{only} | {'yes' if check.needed else ''} | {check.rule} |"


def renewed(page: str) -> str:
    """Return the page with its table made anew.

    Raises:
        ValueError: a mark is missing.
    """
    return with_part(page, BEGIN, END, checks_markdown())


def main() -> None:
    """Renew the page that the command line names."""
    path = Path(sys.argv[1])
    path.write_text(renewed(path.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
