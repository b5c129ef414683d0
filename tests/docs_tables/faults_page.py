"""The tables of docs/faults.md, made from results alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from follower.faults.campaign.tally import Tally
from follower.faults.catalogue import CATALOGUE, in_groups
from follower.faults.fault import LINKS, Fault
from follower.faults.results import Result, Results
from follower.marked_part import with_part
from follower.report.writer import write_whole
from follower_control.strict_yaml import SettingsError

BEGIN, END = "<!-- faults: begin -->", "<!-- faults: end -->"


def check_page(path: Path) -> None:
    """Refuse a page that the tables cannot go into, while there is time.

    Raises:
        SettingsError: it has no marks, or is no text.
        OSError: it cannot be read.
    """
    try:
        with_part(path.read_text("utf-8"), BEGIN, END, "")
    except ValueError as error:
        raise SettingsError(f"--docs {path}: {error}") from None


def write_into(path: Path, results: Results, tally: Tally) -> None:
    """Put the tables between the marks of a Markdown file.

    Raises:
        ValueError: it has no marks.
        OSError: it cannot be read or written.
    """
    body = "\n\n".join(part for part in sections(results, tally) if part)
    write_whole(path, with_part(path.read_text("utf-8"), BEGIN, END, body))


def sections(results: Results, tally: Tally) -> list[str]:
    """Return the tables, a piece of Markdown each."""
    return [
        _summary(list(results)),
        _random(tally),
        *(_group(name, list(results)) for name in in_groups(CATALOGUE)),
        _failures(list(results), tally),
    ]


def _summary(results: Sequence[Result]) -> str:
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
    head = ("autopilot", "link", "clock", "cases", "passed", *(_TITLES[n] for n, _ in _WORST))
    return "### All cases\n\n" + _table(head, rows) if rows else ""


_TITLES = {
    "hold_s": "fault to hold on the wire",
    "wire_s": "decision to wire",
    "rest_s": "fault to rest",
    "excursion_m": "excursion",
    "back_s": "follows again",
    "after_pilot_s": "set-points after the pilot",
}
_WORST = (
    ("wire_s", "ms"),
    ("rest_s", "s"),
    ("excursion_m", "m"),
    ("back_s", "s"),
    ("after_pilot_s", "ms"),
)


def _worst(cases: Iterable[Result], name: str, unit: str) -> str:
    values = [getattr(case.verdict.figures, name) for case in cases]
    known = [value for value in values if value is not None]
    return _number(max(known), unit) if known else "–"


def _number(value: float | None, unit: str) -> str:
    if value is None:
        return "–"
    return f"{1e3 * value:.0f} ms" if unit == "ms" else f"{value:.1f} {unit}"


def _group(name: str, results: Sequence[Result]) -> str:
    faults = in_groups(CATALOGUE)[name]
    rows = []
    for fault in faults:
        cases = [r for r in results if r.verdict.fault == fault.name]
        rows.append(
            (
                f"`{fault.name}`",
                fault.must,
                *(passed_of(fault, link, cases) for link in LINKS),
                _worst(cases, "hold_s", "s") if fault.hold_within_s else "–",
                _worst(cases, "rest_s", "s"),
                _worst(cases, "excursion_m", "m"),
                _worst(cases, "back_s", "s") if fault.outcome in _RETURNING else "–",
            )
        )
    head = ("fault", "what must happen", *LINKS, "hold", "rest", "excursion", "back")
    return f"### {name.capitalize()}\n\n" + _table(head, rows)


def passed_of(fault: Fault, link: str, cases: Sequence[Result]) -> str:
    """Return how many of a link's cases passed, lockstep and real time counted apart.

    What cannot come about on the link has a sign of its own, and so has what was not flown.
    """
    if link not in fault.links:
        return "does not apply"
    here = [case for case in cases if case.link == link]
    missing = [f for f in fault.flavours if f not in {case.flavour for case in here}]
    if not here:
        return "not flown"
    told = f"{sum(case.verdict.passed for case in here)} of {len(here)}"
    return f"{told}; {', '.join(missing)} not flown" if missing else told


_RETURNING = ("follows on", "holds, follows again")


def _random(tally: Tally) -> str:
    if not tally.flights:
        return ""
    speed = tally.steps / tally.busy_s if tally.busy_s else 0.0
    commonest = sorted(tally.faults.items(), key=lambda pair: -pair[1])
    told = ", ".join(f"{count:,} × {name}" for name, count in commonest)
    states = ", ".join(f"{share:.0%} {name}" for name, share in _shares(tally.states))
    return (
        "### Random flights\n\n"
        f"{tally.flights:,} flights, seed {tally.seed}: {tally.steps:,} control steps, "
        f"**{tally.minutes:,.0f} minutes** at 50 Hz, {tally.engaged_steps:,} of the steps while "
        f"the vehicle flew by our set-points; {tally.setpoints:,} set-points on the wire; "
        f"{len(tally.failures)} failures. The longest time from a heartbeat of another mode to the "
        f"last set-point was {_number(tally.after_pilot_s, 'ms')}. {speed:,.0f} steps a second.\n\n"
        f"Faults: {told}.\n\nStates: {states}."
    )


def _shares(counts: dict[str, int]) -> list[tuple[str, float]]:
    total = max(1, sum(counts.values()))
    return [(name, n / total) for name, n in sorted(counts.items(), key=lambda pair: -pair[1])]


def _failures(results: Sequence[Result], tally: Tally) -> str:
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
