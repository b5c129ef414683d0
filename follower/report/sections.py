"""The parts of which the pages about flights are made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
from importlib import resources
from string import Template

from matplotlib.figure import Figure

from follower.report import figures, html, style, tables, timing
from follower.report.flight import Flight
from follower.report.meta import ReportMeta
from follower.report.pathmap import path_map

FigureOf = Callable[[Flight], Figure | None]


def filled(meta: ReportMeta, parts: Iterable[str]) -> str:
    """Return the whole page, one HTML file that needs nothing else."""
    page = resources.files("follower.report").joinpath("page.html").read_text("utf-8")
    return Template(page).substitute(
        title=escape(meta.title),
        subtitle=escape(meta.subtitle),
        light=style.css_variables(dark=False),
        dark=style.css_variables(dark=True),
        body="\n".join(part for part in parts if part),
    )


def verdict_box(kind: str, headline: str, lines: Sequence[str]) -> str:
    """Return what the reader has to know first; kind is "passed", "failed" or ""."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    listed = f"<ul>{items}</ul>" if items else ""
    return f'<div class="verdict {kind}"><strong>{escape(headline)}</strong>{listed}</div>\n'


def states_section(flight: Flight) -> str:
    """Return the supervisor's states, drawn and listed with their reasons."""
    return html.section(
        "States",
        picture(figures.states, flight, "State timeline", "The supervisor's states."),
        tables.states_table(flight.states),
    )


def figure_sections(flight: Flight) -> list[str]:
    """Return the figures over time and the map, a section each."""
    return [
        html.section(title, picture(draw, flight, title, caption, kind))
        for title, draw, caption, kind in _FIGURES
    ]


def timing_section(flight: Flight) -> str:
    """Return how punctual the loops were."""
    return html.section(
        "Timing",
        picture(
            lambda f: timing.histograms(f.log),
            flight,
            "Timing histograms",
            "How late the control loop began, how long its step and vision's work took, and "
            "how old the frame behind a setpoint was. The counts' axis is logarithmic.",
        ),
        tables.timing_table(flight),
    )


def envelope_section(flight: Flight) -> str:
    """Return how often the envelope changed a setpoint."""
    return html.section(
        "Envelope interventions",
        tables.interventions_table(flight)
        or html.paragraph("The envelope changed no setpoint that was sent."),
    )


def events_section(flight: Flight) -> str:
    """Return everything worth a line."""
    return html.section(
        "Events", tables.events_table(flight) or html.paragraph("Nothing was noted.")
    )


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


def picture(draw: FigureOf, flight: Flight, title: str, caption: str, kind: str = "") -> str:
    """Return a drawing with its caption, "" if there is nothing to draw."""
    drawing = draw(flight)
    if drawing is None:
        return ""
    name = "".join(letter for letter in title.lower() if letter.isalpha())
    return html.figure(style.to_svg(drawing, name, escape(title)), caption, kind)


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
        path_map,
        "Both paths from above, north up, equal axes. Thin lines join vehicle and target at the "
        "times given; circles are the start, squares the end.",
        "map",
    ),
)
