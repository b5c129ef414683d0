"""The report's page: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from importlib import resources
from string import Template

from matplotlib.figure import Figure

from follower.flightlog import FlightLog
from follower.report import figures, html, style, tables, timing
from follower.report.flight import Flight
from follower.report.meta import ReportMeta
from follower.report.pathmap import path_map
from follower_sim.criteria import Criteria, checks, verdict
from follower_sim.score import PursuitScore
from follower_vision.track import TrackState

_FigureOf = Callable[[Flight], Figure | None]


def render(flight: Flight, meta: ReportMeta, score: PursuitScore | None, criteria: Criteria) -> str:
    """Return the whole page.

    Args:
        flight: what happened.
        meta: what was run.
        score: None where there is no truth to score by.
        criteria: what the score is held against.
    """
    page = resources.files("follower.report").joinpath("page.html").read_text("utf-8")
    with style.plot_style():
        body = "\n".join(part for part in _parts(flight, meta, score, criteria) if part)
    return Template(page).substitute(
        title=escape(meta.title),
        subtitle=escape(meta.subtitle),
        light=style.css_variables(dark=False),
        dark=style.css_variables(dark=True),
        body=body,
    )


def _parts(
    flight: Flight, meta: ReportMeta, score: PursuitScore | None, criteria: Criteria
) -> list[str]:
    return [
        _headline(flight, meta, score, criteria),
        _video(meta),
        html.section("Score", tables.score_table(checks(score, criteria)) if score else ""),
        *_pictures(flight),
        html.section(
            "Timing",
            _picture(
                lambda f: timing.histograms(f.log),
                flight,
                "Timing histograms",
                "How late the control loop began, how long its step and vision's work took, and "
                "how old the frame behind a setpoint was. The counts' axis is logarithmic.",
            ),
            tables.timing_table(flight),
        ),
        html.section(
            "Envelope interventions",
            tables.interventions_table(flight)
            or html.paragraph("The envelope changed no setpoint that was sent."),
        ),
        html.section("Events", tables.events_table(flight) or html.paragraph("Nothing was noted.")),
        _about(meta),
    ]


def _headline(
    flight: Flight, meta: ReportMeta, score: PursuitScore | None, criteria: Criteria
) -> str:
    remarks = list(meta.remarks)
    if score is None:
        box = _verdict("", f"{flight.length_s:.1f} s, no truth to score by", remarks)
        return box + html.tiles(_log_figures(flight.log))
    failures = verdict(score, criteria)
    headline = "The pursuit failed" if failures else "The pursuit succeeded"
    box = _verdict("failed" if failures else "passed", headline, failures + remarks)
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


def _verdict(kind: str, headline: str, lines: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    listed = f"<ul>{items}</ul>" if items else ""
    return f'<div class="verdict {kind}"><strong>{escape(headline)}</strong>{listed}</div>\n'


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


def _pictures(flight: Flight) -> list[str]:
    return [
        html.section(
            "States",
            _picture(figures.states, flight, "State timeline", "The supervisor's states."),
            tables.states_table(flight.states),
        ),
        *(
            html.section(title, _picture(draw, flight, title, caption, kind))
            for title, draw, caption, kind in _FIGURES
        ),
    ]


_FIGURES: tuple[tuple[str, _FigureOf, str, str], ...] = (
    (
        "Track error",
        figures.line_of_sight,
        "Direction of the target from the vehicle's heading: right and up are positive. "
        "Tinted: the target was unseen, lost, or something held the vehicle.",
        "",
    ),
    (
        "Range and height",
        figures.distance,
        "Distance to the target, and heights above the origin.",
        "",
    ),
    (
        "Commanded and flown velocity",
        figures.velocities,
        "In the heading frame: what the servo asked for, what the envelope let through and what "
        "was flown. Nothing is drawn of setpoints that were not sent.",
        "",
    ),
    ("Tilt", figures.tilt, "Right side down and nose up are positive.", ""),
    (
        "Box in the image",
        figures.image_track,
        "Centre and scale (square root of the area) of the tracker's box, and its confidence. "
        "Tinted: vision did not see the target.",
        "",
    ),
    (
        "Map",
        path_map,
        "Both paths from above, north up, equal axes. Thin lines join vehicle and target at the "
        "times given; circles are the start, squares the end.",
        "map",
    ),
)


def _picture(draw: _FigureOf, flight: Flight, title: str, caption: str, kind: str = "") -> str:
    drawing = draw(flight)
    if drawing is None:
        return ""
    name = "".join(letter for letter in title.lower() if letter.isalpha())
    return html.figure(style.to_svg(drawing, name, escape(title)), caption, kind)


def _about(meta: ReportMeta) -> str:
    files = [
        (html.Html(f'<a href="{escape(name)}">{escape(name)}</a>'), what)
        for name, what in meta.files
    ]
    settings = html.preformatted(meta.settings_yaml) if meta.settings_yaml else ""
    return html.section(
        "This run",
        html.table(("Fact", "Value"), meta.facts),
        html.table(("File", "What it is"), files),
        html.paragraph("To do it again:") + html.preformatted(meta.command) if meta.command else "",
        html.folded("Settings as resolved", settings) if settings else "",
    )
