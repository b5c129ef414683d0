"""`follower inspect`: from a recorded flight's folder to a report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.table import Table
from rich.text import Text

from follower.print_line import print_line
from follower.recorder import FlightConfig, RecordedFlight, open_flight
from follower.report.flight import Flight
from follower.report.inspection import render_inspection, summary
from follower.report.losses import losses
from follower.report.meta import ReportMeta
from follower.report.recording import dropped
from follower.report.series import Span
from follower.report.writer import write_whole
from follower.terminal import STATE_STYLES
from follower_sim.score import PursuitGoal

REPORT = "inspection.html"
FILES = (
    ("flight.mcap", "the log: every message, for Foxglove and PlotJuggler"),
    ("mavlink.tlog", "every MAVLink packet, for Mission Planner and MAVProxy"),
    ("video.mkv", "the frames that vision saw"),
    ("config.yaml", "settings, versions, hashes of networks, seed"),
    ("report.html", "the report that the run itself wrote"),
    ("boxes.csv", "the track, a line a frame"),
    ("setpoints.csv", "the setpoints, a line a control step"),
    ("offset.png", "how the time offset between video and telemetry was found"),
)
_MOST_STATES = 12


def inspect_flight(folder: Path, out: Path | None = None, console: Console | None = None) -> Path:
    """Write the report of a flight, print its summary, and return the report's path.

    Args:
        folder: the flight's.
        out: where the report goes; into the flight's folder if not given.
        console: takes the summary.

    Raises:
        FlightFileError: the flight cannot be read; one line says why and what could be.
        OSError: the report cannot be written.
    """
    return inspect_recorded(open_flight(folder), out, console)


def inspect_recorded(
    recorded: RecordedFlight, out: Path | None = None, console: Console | None = None
) -> Path:
    """Do the same for a flight that was read already."""
    flight = prepared(recorded)
    path = write_inspection(recorded, flight, out)
    print_summary(console or Console(), recorded, flight, path)
    return path


def prepared(recorded: RecordedFlight) -> Flight:
    """Return a recorded flight, prepared for figures."""
    size_m = recorded.config.number("servo", "target_size_m")
    goal = _goal(recorded.config) if recorded.truth else None
    return Flight.of(recorded.log, recorded.truth, goal, size_m)


def write_inspection(
    recorded: RecordedFlight, flight: Flight, out: Path | None = None, more: Sequence[str] = ()
) -> Path:
    """Write the report and return its path; `more` are sections of the caller's own, HTML."""
    path = out or recorded.folder / REPORT
    page = render_inspection(recorded, flight, _meta(recorded, path), more)
    return write_whole(path, page)


def print_summary(console: Console, recorded: RecordedFlight, flight: Flight, path: Path) -> None:
    """Write the flight's few figures, its states, and what the recording lacks."""
    table = Table(show_edge=False, pad_edge=False, show_header=False, box=None)
    table.add_column(style="dim")
    table.add_column()
    for name, value in summary(recorded, flight, losses(flight)):
        table.add_row(name, value)
    console.print(Text(_title(recorded), "bold"))
    console.print(table)
    if flight.states:
        console.print()
        console.print(_states(flight.states))
    for line in dropped(recorded):
        print_line(console, line, "yellow")
    console.print()
    print_line(console, f"  {path}")


def _states(spans: Sequence[Span]) -> Table:
    table = Table(show_edge=False, pad_edge=False, header_style="dim", box=None)
    table.add_column("From", justify="right")
    table.add_column("For", justify="right")
    table.add_column("State")
    table.add_column("Reason")
    for span in spans[:_MOST_STATES]:
        state = Text(span.state, STATE_STYLES.get(span.state, ""))
        table.add_row(f"{span.start_s:.1f} s", f"{span.length_s:.1f} s", state, span.reason)
    if len(spans) > _MOST_STATES:
        table.add_row("", "", f"… {len(spans) - _MOST_STATES} more", "in the report")
    return table


def _goal(config: FlightConfig) -> PursuitGoal | None:
    """Return what was wanted, None if the settings do not say it in a form known here."""
    elevation_deg = config.number("servo", "elevation_deg")
    if elevation_deg is None:
        elevation_deg = config.number("camera", "pitch_deg") or 0.0
    watching = config.group("servo").get("mode") == "watch"
    distance_m = None if watching else config.number("servo", "distance_m")
    try:
        return PursuitGoal(distance_m, math.radians(elevation_deg))
    except ValueError:
        return None


def _title(recorded: RecordedFlight) -> str:
    return str(recorded.config.run.get("title") or recorded.folder.resolve().name)


def _meta(recorded: RecordedFlight, path: Path) -> ReportMeta:
    config = recorded.config
    own = path.parent.resolve() == recorded.folder.resolve()
    run = {key: value for key, value in config.run.items() if key not in ("title", "command")}
    versions = ", ".join(f"{name} {value}" for name, value in config.versions.items())
    facts = [
        ("Folder", str(recorded.folder.resolve().name)),
        ("Kind", config.kind),
        *_flat("", run),
        ("Versions", versions),
        *((f"SHA-256 of {name}", value) for name, value in config.models.items()),
    ]
    shown = (f"{key} {value}" for key, value in _flat("", run))
    return ReportMeta(
        title=_title(recorded),
        subtitle=" · ".join((config.kind, *list(shown)[:5])),
        command=str(config.run.get("command", "")),
        settings_yaml=yaml.safe_dump(config.settings, sort_keys=False),
        facts=tuple(facts),
        files=tuple(f for f in FILES if own and (recorded.folder / f[0]).is_file()),
    )


def _flat(prefix: str, plain: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return nested facts as ("offset quality", "0.97")."""
    rows: list[tuple[str, str]] = []
    for key, value in plain.items():
        name = f"{prefix} {key}".strip().replace("_", " ")
        rows += _flat(name, value) if isinstance(value, Mapping) else [(name, str(value))]
    return rows
