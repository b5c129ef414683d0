"""The report of a flight that was wanted: what came of it, held against a score."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from matplotlib.figure import Figure

from follower.flight.log import FlightLog, failed_plugins
from follower.flight.supervision.flight_end import HANDED_OVER, SUCCESS, pursuit_end
from follower.report import figures, html, style
from follower.report.series import LoggedFlight, ReportMeta, timings
from follower_control.servo.settings import ServoSettings
from follower_sim.kinematics import TruthSample
from follower_sim.scenario.scenario import Criteria
from follower_sim.scoring.criteria import CriterionResult, checks, verdict
from follower_sim.scoring.score import PursuitGoal, PursuitScore
from follower_vision.disk import write_whole

FigureOf = Callable[[LoggedFlight], Figure | None]

REPORT, SCORE = "report.html", "score.json"
_FIGURES: tuple[tuple[str, FigureOf, str, str], ...] = (
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
        figures.path_map,
        "Both paths from above, north up, equal axes. Thin lines join vehicle and target at the "
        "times given; circles are the start, squares the end.",
        "map",
    ),
)


def write_report(
    folder: Path,
    log: FlightLog,
    meta: ReportMeta,
    *,
    score: PursuitScore,
    criteria: Criteria,
    truth: Sequence[TruthSample] = (),
    goal: PursuitGoal | None = None,
    servo: ServoSettings | None = None,
) -> Path:
    """Write `report.html` and return its path. Works with any log, an empty one too.

    Args:
        folder: exists already.
        log: the flight.
        meta: what was run.
        score: what the flight is worth.
        criteria: what the score is held against.
        truth: the simulator's samples; without them nothing true is drawn.
        goal: the wanted direction and distance, for the plots.
        servo: its settings; with them the range that it goes by is drawn.

    Raises:
        OSError: it cannot be written.
    """
    flight = LoggedFlight(log, truth, goal, servo, score)
    return write_whole(folder / REPORT, render(flight, meta, score, criteria))


def write_score(
    folder: Path, score: PursuitScore, criteria: Criteria, run: Mapping[str, object]
) -> Path:
    """Write `score.json`: whether it passed, the failures, the figures and the criteria.

    Args:
        folder: exists already.
        score: figures that could not be measured are written as null.
        criteria: what the score is held against.
        run: what was run, e.g. scenario, autopilot and seed.

    Raises:
        OSError: it cannot be written.
    """
    failures = verdict(score, criteria)
    content = {
        "passed": not failures,
        "failures": failures,
        "run": dict(run),
        "score": score.to_dict(),
        "criteria": asdict(criteria),
    }
    return write_whole(folder / SCORE, json.dumps(content, indent=2, allow_nan=False) + "\n")


def render(flight: LoggedFlight, meta: ReportMeta, score: PursuitScore, criteria: Criteria) -> str:
    """Return the whole page."""
    with style.plot_style():
        parts = [
            _headline(flight, meta, score, criteria),
            _video(meta),
            html.section("Score", _score_table(checks(score, criteria))),
            states_section(flight),
            *figure_sections(flight),
            timing_section(flight),
            envelope_section(flight),
            events_section(flight),
            about(meta),
        ]
        return filled(meta, parts)


def _headline(
    flight: LoggedFlight, meta: ReportMeta, score: PursuitScore, criteria: Criteria
) -> str:
    remarks = [*failed_plugins(flight.log), *meta.remarks]
    failures = verdict(score, criteria)
    end = meta.end or pursuit_end(failures)
    kind = {SUCCESS: "passed", HANDED_OVER: ""}.get(end.exit_code, "failed")
    box = verdict_box(kind, end.sentence, (failures if kind else []) + remarks)
    shown = {check.name: check.value for check in checks(score, criteria)}
    chosen = (
        "Target in frame",
        "Line-of-sight error, RMS",
        "Range error, median",
        "Time to acquire",
        "Searches begun",
        "Capture to setpoint, median",
    )
    return box + html.tiles((name, shown[name]) for name in chosen)


def _video(meta: ReportMeta) -> str:
    if not meta.video:
        return ""
    return f'<video controls preload="metadata" src="{escape(meta.video)}"></video>'


def filled(meta: ReportMeta, parts: Iterable[str], rules: str = "") -> str:
    """Return the whole page, one HTML file that needs nothing else; `rules` are CSS of its own."""
    page = resources.files("follower.report").joinpath("flight_page.html").read_text("utf-8")
    return Template(page).substitute(
        title=escape(meta.title),
        subtitle=escape(meta.subtitle),
        light=style.css_variables(dark=False),
        dark=style.css_variables(dark=True),
        rules=rules,
        body="\n".join(part for part in parts if part),
    )


def verdict_box(kind: str, headline: str, lines: Sequence[str]) -> str:
    """Return what the reader has to know first; kind is "passed", "failed" or ""."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    listed = f"<ul>{items}</ul>" if items else ""
    return f'<div class="verdict {kind}"><strong>{escape(headline)}</strong>{listed}</div>\n'


def _score_table(results: Sequence[CriterionResult]) -> str:
    rows = [(one.name, one.value, one.limit, _mark(one.passed)) for one in results]
    return html.table(("Figure", "Value", "Limit", ""), rows, numbers=(1, 2))


def _mark(passed: bool | None) -> html.Html:
    if passed is None:
        return html.Html("")
    word = "passed" if passed else "failed"
    return html.Html(f'<span class="mark {word}">{"✓" if passed else "✗"} {word}</span>')


def states_section(flight: LoggedFlight) -> str:
    """Return the supervisor's states, drawn and listed with their reasons."""
    rows = [
        (_state(span.state), span.reason, f"{span.start_s:.2f}", f"{span.length_s:.2f}")
        for span in flight.states
    ]
    table = html.table(("State", "Reason", "From [s]", "For [s]"), rows, numbers=(2, 3))
    return html.section(
        "States",
        picture(figures.states, flight, "State timeline", "The supervisor's states."),
        html.folded_if_long(table, len(rows), "states"),
    )


def _state(name: str) -> html.Html:
    colour = style.STATES[name].name if name in style.STATES else "muted"
    swatch = f'<span class="swatch" style="background: var(--{colour})"></span>'
    return html.Html(f'<span class="state">{swatch}{escape(name)}</span>')


def figure_sections(flight: LoggedFlight) -> list[str]:
    """Return the figures over time and the map, a section each."""
    return [
        html.section(title, picture(draw, flight, title, caption, kind))
        for title, draw, caption, kind in _FIGURES
    ]


def timing_section(flight: LoggedFlight) -> str:
    """Return how punctual the loops were: median, 99th percentile and largest of each timing."""
    rows = [
        (timing.name, *(f"{timing.percentile_ms(percent):.2f}" for percent in (50, 99, 100)))
        for timing in timings(flight.log)
    ]
    head = ("Time in ms", "Median", "99th percentile", "Largest")
    return html.section(
        "Timing",
        picture(
            lambda f: figures.timing_histograms(f.log),
            flight,
            "Timing histograms",
            "How late the control loop began, how long its step and vision's work took, and "
            "how old the frame behind a setpoint was. The counts' axis is logarithmic.",
        ),
        html.table(head, rows, numbers=(1, 2, 3)),
    )


def envelope_section(flight: LoggedFlight) -> str:
    """Return how often each limit of the envelope changed a setpoint that was sent."""
    sent = [record for record in flight.log.controls if record.sent]
    counts = Counter(str(name) for record in sent for name in record.limits)
    rows = [
        (name, str(number), f"{100 * number / len(sent):.1f} %")
        for name, number in counts.most_common()
    ]
    table = html.table(("Limit", "Steps", "Of those sent"), rows, numbers=(1, 2))
    none = html.paragraph("The envelope changed no setpoint that was sent.")
    return html.section("Envelope interventions", table or none)


def events_section(flight: LoggedFlight) -> str:
    """Return everything worth a line, with its time."""
    rows = [(f"{e.time_s - flight.start_s:.2f}", e.source, e.text) for e in flight.log.events]
    table = html.table(("Time [s]", "Source", "Event"), rows, numbers=(0,))
    listed = html.folded_if_long(table, len(rows), "events")
    return html.section("Events", listed or html.paragraph("Nothing was noted."))


def about(meta: ReportMeta) -> str:
    """Return what was run, and how to run it again."""
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


def picture(draw: FigureOf, flight: LoggedFlight, title: str, caption: str, kind: str = "") -> str:
    """Return a drawing with its caption, "" if there is nothing to draw."""
    drawing = draw(flight)
    if drawing is None:
        return ""
    name = "".join(letter for letter in title.lower() if letter.isalpha())
    return html.figure(style.to_svg(drawing, name, escape(title)), caption, kind)
