"""The report's tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from follower.report import html, style
from follower.report.flight import Flight
from follower.report.html import Html
from follower.report.series import Span
from follower.report.timing import timings
from follower_sim.criteria import Check

_LONG = 25
"""Tables longer than this are folded."""


def score_table(checks: Sequence[Check]) -> str:
    """Return every figure with its limit."""
    rows = [(check.name, check.value, check.limit, _mark(check.passed)) for check in checks]
    return html.table(("Figure", "Value", "Limit", ""), rows, numbers=(1, 2))


def _mark(passed: bool | None) -> Html:
    if passed is None:
        return Html("")
    word = "passed" if passed else "failed"
    return Html(f'<span class="mark {word}">{"✓" if passed else "✗"} {word}</span>')


def states_table(spans: Sequence[Span]) -> str:
    """Return the supervisor's states, one row for each stay."""
    rows = [
        (_state(span.state), span.reason, f"{span.start_s:.2f}", f"{span.length_s:.2f}")
        for span in spans
    ]
    table = html.table(("State", "Reason", "From [s]", "For [s]"), rows, numbers=(2, 3))
    return _folded_if_long("states", table, len(rows))


def _state(name: str) -> Html:
    colour = style.STATES[name].name if name in style.STATES else "muted"
    swatch = f'<span class="swatch" style="background: var(--{colour})"></span>'
    return Html(f'<span class="state">{swatch}{html.text_of(name)}</span>')


def events_table(flight: Flight) -> str:
    """Return everything worth a line, with its time."""
    rows = [(f"{e.time_s - flight.start_s:.2f}", e.source, e.text) for e in flight.log.events]
    table = html.table(("Time [s]", "Source", "Event"), rows, numbers=(0,))
    return _folded_if_long("events", table, len(rows))


def interventions_table(flight: Flight) -> str:
    """Return how often each limit of the envelope changed a setpoint that was sent."""
    sent = [record for record in flight.log.controls if record.sent]
    counts = Counter(str(name) for record in sent for name in record.limits)
    rows = [
        (name, str(number), f"{100 * number / len(sent):.1f} %")
        for name, number in counts.most_common()
    ]
    return html.table(("Limit", "Steps", "Of those sent"), rows, numbers=(1, 2))


def timing_table(flight: Flight) -> str:
    """Return median, 99th percentile and largest of each timing."""
    rows = [
        (timing.name, *(f"{timing.percentile_ms(percent):.2f}" for percent in (50, 99, 100)))
        for timing in timings(flight.log)
    ]
    head = ("Time in ms", "Median", "99th percentile", "Largest")
    return html.table(head, rows, numbers=(1, 2, 3))


def _folded_if_long(name: str, table: str, length: int) -> str:
    return html.folded(f"{length} {name}", table) if length > _LONG else table
