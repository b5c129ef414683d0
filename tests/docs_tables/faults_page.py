"""The tables of docs/reference/faults.md, made from results alone.

    python tests/docs_tables/faults_page.py [runs/faults]

puts those of a folder that `follower faults --out` filled between the page's two marks.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path

from marked_part import with_part

from follower.settings.link import LINK_KINDS
from follower.simulation.fault_tests.command import RESULTS, TALLY
from follower.simulation.fault_tests.results import FaultResult, Results, Tally
from follower.simulation.faults.fault import Fault, in_groups

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "faults.md"
BEGIN, END = "<!-- faults: begin -->", "<!-- faults: end -->"
_UNKNOWN = "–"


def renewed(page: str, folder: Path) -> str:
    """Return the page with the tables of a folder of results.

    Raises:
        ValueError: the page has no marks.
    """
    results, tally = Results(folder / RESULTS), Tally.load(folder / TALLY)
    body = "\n\n".join(part for part in sections(results, tally) if part)
    return with_part(page, BEGIN, END, body)


def sections(results: Results, tally: Tally) -> list[str]:
    """Return the tables, a piece of Markdown each."""
    return [
        _summary(list(results)),
        _random(tally),
        *(_group(name, list(results)) for name in in_groups()),
        _failures(list(results), tally),
    ]


def _summary(results: Sequence[FaultResult]) -> str:
    rows = []
    for key in dict.fromkeys((r.flavour, r.link, r.realtime) for r in results):
        cases = [r for r in results if (r.flavour, r.link, r.realtime) == key]
        flavour, link, realtime = key
        rows.append(
            (
                flavour,
                link,
                "real time" if realtime else "lockstep",
                str(len(cases)),
                str(sum(case.verdict.passed for case in cases)),
                *(_worst(cases, name, unit) for name, unit in _WORST),
            )
        )
    titles = (f"{_TITLES[name]}, {unit}" for name, unit in _WORST)
    head = ("autopilot", "link", "clock", "cases", "passed", *titles)
    return "### All cases\n\n" + _table(head, rows) if rows else ""


_TITLES = {
    "hold_s": "fault to hold on the wire",
    "wire_s": "decision to wire",
    "rest_s": "fault to rest",
    "excursion_m": "excursion",
    "back_s": "follows again",
    "after_pilot_s": "setpoints after the pilot",
}
_WORST = (
    ("wire_s", "ms"),
    ("rest_s", "s"),
    ("excursion_m", "m"),
    ("back_s", "s"),
    ("after_pilot_s", "ms"),
)


def _worst(cases: Iterable[FaultResult], name: str, unit: str) -> str:
    values = [getattr(case.verdict.figures, name) for case in cases]
    known = [value for value in values if value is not None]
    return _number(max(known), unit) if known else _UNKNOWN


def _number(value: float, unit: str) -> str:
    return f"{1e3 * value:.0f}" if unit == "ms" else f"{value:.1f}"


def _group(name: str, results: Sequence[FaultResult]) -> str:
    faults = in_groups()[name]
    flown = {f: [r for r in results if r.verdict.fault == f.name] for f in faults}
    lines = []
    for must, alike in groupby(faults, lambda f: f"{f.must}{_exceptions(f, flown[f])}"):
        lines.append(f"- {', '.join(f'`{f.name}`' for f in alike)}: {must}")
    return f"### {name.capitalize()}\n\n{_measured(flown)}\n\n" + "\n".join(lines)


def _measured(flown: Mapping[Fault, Sequence[FaultResult]]) -> str:
    """Return how many cases of a group passed, and their worst figures."""
    cases = [case for each in flown.values() for case in each]
    holding = [case for f, each in flown.items() if f.hold_within_s for case in each]
    returning = [case for f, each in flown.items() if f.outcome in _RETURNING for case in each]
    figures = (
        ("hold", _worst(holding, "hold_s", "s"), "s"),
        ("rest", _worst(cases, "rest_s", "s"), "s"),
        ("excursion", _worst(cases, "excursion_m", "m"), "m"),
        ("follows again", _worst(returning, "back_s", "s"), "s"),
    )
    known = [f"{title} {value} {unit}" for title, value, unit in figures if value != _UNKNOWN]
    passed = f"{sum(case.verdict.passed for case in cases)}/{len(cases)} cases passed"
    return "; ".join([passed, *([f"worst: {', '.join(known)}"] if known else [])]) + "."


def _exceptions(fault: Fault, cases: Sequence[FaultResult]) -> str:
    """Return the links over which not each case of a fault was flown and passed."""
    told = {link: passed_of(fault, link, cases) for link in LINK_KINDS}
    whole = {link: re.fullmatch(r"(\d+)/\1", text) for link, text in told.items()}
    left = [f"{link} {text}" for link, text in told.items() if not whole[link]]
    return f" ({'; '.join(left)})" if left else ""


def passed_of(fault: Fault, link: str, cases: Sequence[FaultResult]) -> str:
    """Return how many of a link's cases passed, lockstep and real time counted apart.

    What cannot come about on the link has a sign of its own, and so has what was not flown.
    """
    if link not in fault.links:
        return "does not apply"
    here = [case for case in cases if case.link == link]
    missing = [f for f in fault.flavours if f not in {case.flavour for case in here}]
    if not here:
        return "not flown"
    told = f"{sum(case.verdict.passed for case in here)}/{len(here)}"
    return f"{told}; {', '.join(missing)} not flown" if missing else told


_RETURNING = ("follows on", "holds, follows again")


def _random(tally: Tally) -> str:
    if not tally.flights:
        return ""
    speed = tally.steps / tally.busy_s if tally.busy_s else 0.0
    counts = sorted(tally.faults.values())
    told = f"{counts[0]:,} to {counts[-1]:,} of each" if counts else "none"
    states = ", ".join(f"{share:.0%} {name}" for name, share in _shares(tally.states))
    return (
        "### Random flights\n\n"
        f"{tally.flights:,} flights, seed {tally.seed}: {tally.steps:,} control steps, "
        f"**{tally.minutes:,.0f} minutes** at 50 Hz, {tally.engaged_steps:,} of the steps while "
        f"the vehicle flew the follower's setpoints; {tally.setpoints:,} setpoints on the wire; "
        f"{len(tally.failures)} failures. The longest time from a heartbeat of another mode to the "
        f"last setpoint was {_number(tally.after_pilot_s, 'ms')} ms. {speed:,.0f} steps a second."
        f"\n\nFaults: {len(counts)} kinds, {told}.\n\nStates: {states}."
    )


def _shares(counts: dict[str, int]) -> list[tuple[str, float]]:
    total = max(1, sum(counts.values()))
    return [(name, n / total) for name, n in sorted(counts.items(), key=lambda pair: -pair[1])]


def _failures(results: Sequence[FaultResult], tally: Tally) -> str:
    lines = [
        f"- {case.key}: {'; '.join(case.verdict.failures)}"
        for case in results
        if not case.verdict.passed
    ]
    lines += [f"- random flight {number}: {what}" for number, what in tally.failures.items()]
    return "### What fails\n\n" + ("\n".join(lines) if lines else "Nothing.")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def main(folder: str = "runs/faults") -> None:
    """Renew the page."""
    PAGE.write_text(renewed(PAGE.read_text("utf-8"), Path(folder)), "utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
