"""The report of a recorded flight: what happened, and what the recording lacks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from follower.recorder import FlightFileError, RecordedFlight
from follower.report import html, sections, style
from follower.report.delays import delays, first_uses
from follower.report.flight import Flight
from follower.report.losses import Loss, losses, losses_section, pick_images, wanted_frames
from follower.report.meta import ReportMeta
from follower.report.pilot_plot import pilot_and_vehicle
from follower.report.recording import dropped, recording_section, seen_share
from follower.supervisor import State


def render_inspection(
    recorded: RecordedFlight, flight: Flight, meta: ReportMeta, more: Sequence[str] = ()
) -> str:
    """Return the whole page.

    Args:
        recorded: what the folder holds.
        flight: the same, prepared for figures.
        meta: what was run.
        more: sections of the caller's own, HTML, which come before the states.
    """
    found = losses(flight)
    lost = _losses_section(recorded, flight, found)
    with style.plot_style():
        parts = [
            _headline(recorded, flight, meta, found),
            *more,
            sections.states_section(flight),
            lost,
            *sections.figure_sections(flight),
            _pilot_section(flight),
            _delays_section(flight),
            sections.timing_section(flight),
            sections.envelope_section(flight),
            recording_section(recorded, flight.length_s),
            sections.events_section(flight),
            sections.about(meta),
        ]
        return sections.filled(meta, parts)


def summary(
    recorded: RecordedFlight, flight: Flight, found: Sequence[Loss]
) -> list[tuple[str, str]]:
    """Return the few figures that a reader looks for first: (name, value)."""
    figures = [("Length", f"{flight.length_s:.1f} s"), ("Frames", str(len(recorded.frames)))]
    followed_s = sum(span.length_s for span in flight.states if span.state == State.FOLLOWING)
    if flight.states:
        figures.append(("Following", f"{followed_s:.1f} s"))
    share = seen_share(recorded)
    if share is not None:
        figures.append(("Target seen", f"{100 * share:.1f} %"))
        figures.append(("Losses", str(len(found))))
    used_s = [used - captured for captured, used in first_uses(flight.log).items()]
    if used_s:
        median, p99 = 1e3 * np.percentile(used_s, (50, 99))
        figures.append(("Capture to setpoint, median", f"{median:.0f} ms"))
        figures.append(("Capture to setpoint, 99 %", f"{p99:.0f} ms"))
    return figures


def _headline(
    recorded: RecordedFlight, flight: Flight, meta: ReportMeta, found: Sequence[Loss]
) -> str:
    lines = [*meta.remarks, *dropped(recorded)]
    kind = recorded.config.kind
    flown = " flight" if kind in ("simulated", "real") else ""
    said = f"{flight.length_s:.1f} s of {kind}{flown}"
    missing = ", with parts missing" if recorded.remarks else ""
    box = sections.verdict_box("failed" if recorded.remarks else "", said + missing, lines)
    return box + html.tiles(summary(recorded, flight, found))


def _losses_section(recorded: RecordedFlight, flight: Flight, found: Sequence[Loss]) -> str:
    if seen_share(recorded) is None:
        return html.section("Losses", html.paragraph("No target was ever chosen."))
    pictures, remark, wanted = {}, "", wanted_frames(found)
    if wanted:
        try:
            pictures = pick_images(recorded.pictures(), wanted)
        except FlightFileError as error:
            remark = f"No pictures: {error}."
    return losses_section(found, pictures, flight.start_s, remark)


def _pilot_section(flight: Flight) -> str:
    return html.section(
        "Pilot, gimbal and health",
        sections.picture(
            pilot_and_vehicle,
            flight,
            "Pilot, gimbal and health",
            "What the recording knows of these: the transmitter's channels; whether consent stood, "
            "the mode allowed following and a stick was far out; the gimbal's angles; the battery; "
            "the estimator's worst innovation over its limit.",
        ),
    )


def _delays_section(flight: Flight) -> str:
    return html.section(
        "Delays and ages",
        sections.picture(
            delays,
            flight,
            "Delays and ages",
            "Above, for each frame: from its capture until vision took it, until vision's answer, "
            "and until the first setpoint made from it. Below, at each control step: how old the "
            "newest telemetry and the frame behind the setpoint were.",
        ),
    )
