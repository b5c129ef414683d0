"""The report of a flight that was wanted: what came of it, held against a score."""

from __future__ import annotations

from html import escape

from follower.flightlog import FlightLog
from follower.report import html, sections, style, tables, timing
from follower.report.flight import Flight
from follower.report.meta import ReportMeta
from follower_sim.criteria import Criteria, checks, verdict
from follower_sim.score import PursuitScore
from follower_vision.track import TrackState


def render(flight: Flight, meta: ReportMeta, score: PursuitScore | None, criteria: Criteria) -> str:
    """Return the whole page.

    Args:
        flight: what happened.
        meta: what was run.
        score: None where there is no truth to score by.
        criteria: what the score is held against.
    """
    with style.plot_style():
        return sections.filled(meta, _parts(flight, meta, score, criteria))


def _parts(
    flight: Flight, meta: ReportMeta, score: PursuitScore | None, criteria: Criteria
) -> list[str]:
    return [
        _headline(flight, meta, score, criteria),
        _video(meta),
        html.section("Score", tables.score_table(checks(score, criteria)) if score else ""),
        sections.states_section(flight),
        *sections.figure_sections(flight),
        sections.timing_section(flight),
        sections.envelope_section(flight),
        sections.events_section(flight),
        sections.about(meta),
    ]


def _headline(
    flight: Flight, meta: ReportMeta, score: PursuitScore | None, criteria: Criteria
) -> str:
    remarks = list(meta.remarks)
    if score is None:
        box = sections.verdict_box("", f"{flight.length_s:.1f} s, no truth to score by", remarks)
        return box + html.tiles(_log_figures(flight.log))
    failures = verdict(score, criteria)
    headline = "The pursuit failed" if failures else "The pursuit succeeded"
    box = sections.verdict_box("failed" if failures else "passed", headline, failures + remarks)
    shown = {check.name: check.value for check in checks(score, criteria)}
    chosen = (
        "Target in frame",
        "Line-of-sight error, RMS",
        "Range error, median",
        "Time to acquire",
        "Losses",
        "Capture to setpoint, median",
    )
    return box + html.tiles((name, shown[name]) for name in chosen)


def _log_figures(log: FlightLog) -> list[tuple[str, str]]:
    states = [record.track.state for record in log.tracks if record.track is not None]
    seen = states.count(TrackState.TRACKING)
    figures_shown = [("Frames", str(len(log.tracks)))]
    if states:
        figures_shown.append(("Target seen", f"{100 * seen / len(states):.1f} %"))
    measured = {t.name: t for t in timing.timings(log)}
    for name in ("vision: one frame's work", "capture to setpoint"):
        if name in measured:
            median = measured[name].percentile_ms(50)
            figures_shown.append((f"{name}, median", f"{median:.1f} ms"))
    return figures_shown


def _video(meta: ReportMeta) -> str:
    if not meta.video:
        return ""
    return f'<video controls preload="metadata" src="{escape(meta.video)}"></video>'
