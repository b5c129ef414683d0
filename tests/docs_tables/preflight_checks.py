"""The list of checks in docs/how-to/fly.md, from the table of checks.

    python tests/docs_tables/preflight_checks.py

writes it again between the page's two marks; a test checks that it is up to date.
"""

from __future__ import annotations

from itertools import groupby
from typing import Any

from marked_part import MarkedPart

from follower.apps.preflight.check import BOTH, PreflightCheck
from follower.apps.preflight.checklist import CHECKS


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


CHECK_LIST = MarkedPart("how-to/fly.md", "checks", checks_markdown)

if __name__ == "__main__":
    CHECK_LIST.renew()
