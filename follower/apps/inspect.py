"""`follower inspect`: from a recorded flight's folder to a report."""

import math
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table
from rich.text import Text

from follower.flight.log import failed_plugins, setpoint_delays
from follower.flight.supervision.flight_end import BROKEN_OFF, NOT_BEGUN, LastRelease
from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import FlightConfig, FlightFileError, RecordedFlight, open_flight
from follower.recording.messages import MESSAGES
from follower.recording.recorded_flight import check_not_of
from follower.recording.video_reader import video_problem
from follower.recording.video_writer import VIDEO
from follower.report import flight_page, html, style
from follower.report.pilot_plot import delays, pilot_and_vehicle
from follower.report.series import LoggedFlight, ReportMeta, Span
from follower.report.track_losses import (
    TITLE,
    TrackLoss,
    losses,
    losses_section,
    pick_images,
    wanted_frames,
)
from follower.ui.terminal.console import check_extra, print_line
from follower.ui.terminal.flight_display import STATE_STYLES
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_sim.scoring.score import PursuitGoal
from follower_vision.disk import failure_said, is_unwritable, write_whole
from follower_vision.trackers.track import TrackState

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
_PROCESSOR = (("features", "Processor features"), ("blas", "BLAS kernels"))
_MOST_STATES = 12
_FIGURES = (
    (
        "Pilot, gimbal and health",
        pilot_and_vehicle,
        "What the recording knows of these: the transmitter's channels; whether consent stood, "
        "the mode allowed following and a stick was far out; the gimbal's angles; the battery; "
        "the estimator's worst innovation over its limit.",
    ),
    (
        "Delays and ages",
        delays,
        "Above, for each frame: from its capture until vision took it, until vision's answer, "
        "and until the first setpoint that was made from it and sent. Below, at each control "
        "step: how old the newest telemetry and the frame behind the setpoint were.",
    ),
)


def recording_section(recorded: RecordedFlight, length_s: float) -> str:
    """Return what was recorded, how often it came, and what was dropped."""
    counts = Counter(str(one.verdict) for one in recorded.observations)
    verdicts = [(name, str(number)) for name, number in counts.most_common()]
    return html.section(
        "Recording",
        html.table(("Frames", "Number"), frame_rows(recorded), numbers=(1,)),
        html.table(
            ("Message", "Number", "A second", "Meant"), _message_rows(recorded, length_s), (1, 2)
        ),
        html.table(("Observations", "Number"), verdicts, numbers=(1,)),
        *(html.paragraph(remark) for remark in recorded.remarks),
    )


def frame_rows(recorded: RecordedFlight) -> list[tuple[str, str]]:
    """Return what became of the frames: (what, how many)."""
    frames = recorded.frames
    missed = sum(max(0, b.sequence - a.sequence - 1) for a, b in pairwise(frames))
    in_video = sum(frame.video_index is not None for frame in frames)
    return [
        ("that vision took", str(len(frames))),
        ("that it did not take (gaps in the source's numbers)", str(missed)),
        ("in the video", str(in_video)),
        ("left out of the video", str(len(frames) - in_video)),
        ("without an answer in the log", str(max(0, len(frames) - len(recorded.log.tracks)))),
    ]


def dropped(recorded: RecordedFlight) -> list[str]:
    """Return what the recording lacks, in sentences: the recorder's words and the reader's."""
    said = [event.text for event in recorded.log.events if event.source == "recorder"]
    return [*(f"The recorder said: {text}." for text in said), *recorded.remarks]


def _remarks(recorded: RecordedFlight) -> list[str]:
    """Return what went wrong in the flight's parts and in its recording, in sentences."""
    return [*failed_plugins(recorded.log), *dropped(recorded)]


def seen_share(recorded: RecordedFlight) -> float | None:
    """Return the share of the frames with a chosen target in which vision saw it."""
    states = [record.track.state for record in recorded.log.tracks if record.track is not None]
    return states.count(TrackState.TRACKING) / len(states) if states else None


def _message_rows(recorded: RecordedFlight, length_s: float) -> list[tuple[str, str, str, str]]:
    counts = Counter(type(message) for _, message in recorded.messages())
    packets = sum(1 for _ in recorded.packets())
    rows = [
        (one.topic, str(counts[one.record]), _rate(counts[one.record], length_s), one.rate)
        for one in MESSAGES
        if counts[one.record]
    ]
    link = ("MAVLink packets, both ways", str(packets), _rate(packets, length_s), "as they come")
    return [*rows, link] if packets else rows


def _rate(count: int, length_s: float) -> str:
    return f"{count / length_s:.1f}" if length_s > 0 else ""


def _page(
    recorded: RecordedFlight,
    flight: LoggedFlight,
    found: Sequence[TrackLoss],
    meta: ReportMeta,
    more: Sequence[str],
) -> str:
    # Both read files and may find them damaged, which the headline is to say.
    lost = _losses_section(recorded, flight, found)
    kept = recording_section(recorded, flight.length_s)
    with style.plot_style():
        parts = [
            _headline(recorded, flight, meta, found),
            *more,
            flight_page.states_section(flight),
            lost,
            *flight_page.figure_sections(flight),
            *(
                html.section(title, flight_page.picture(draw, flight, title, caption))
                for title, draw, caption in _FIGURES
            ),
            flight_page.timing_section(flight),
            flight_page.envelope_section(flight),
            kept,
            flight_page.events_section(flight),
            flight_page.about(meta),
        ]
        return flight_page.filled(meta, parts)


def summary(
    recorded: RecordedFlight, flight: LoggedFlight, found: Sequence[TrackLoss]
) -> list[tuple[str, str]]:
    """Return the few figures that a reader looks for first: (name, value)."""
    figures = [("Length", f"{flight.length_s:.1f} s"), ("Frames", str(len(recorded.frames)))]
    followed_s = sum(
        span.length_s for span in flight.states if span.state == SupervisorState.FOLLOWING
    )
    if flight.states:
        figures.append(("Following", f"{followed_s:.1f} s"))
        if recorded.config.kind != "video":
            figures.append(("End", _end(recorded)))
    share = seen_share(recorded)
    if share is not None:
        figures.append(("Target seen", f"{100 * share:.1f} %"))
        figures.append(("Times not seen", str(len(found))))
    delays_s = list(setpoint_delays(flight.log.controls).values())
    if delays_s:
        median, p99 = 1e3 * np.percentile(delays_s, (50, 99))
        figures.append(("Capture to setpoint, median", f"{median:.0f} ms"))
        figures.append(("Capture to setpoint, 99 %", f"{p99:.0f} ms"))
    return figures


def _end(recorded: RecordedFlight) -> str:
    release = LastRelease.of((record.state, record.reason) for record in recorded.log.controls)
    cut_off = not recorded.whole and release.end is NOT_BEGUN
    return "not recorded" if cut_off or release.end is BROKEN_OFF else release.end.sentence


def _headline(
    recorded: RecordedFlight, flight: LoggedFlight, meta: ReportMeta, found: Sequence[TrackLoss]
) -> str:
    lines = [*meta.remarks, *_remarks(recorded)]
    kind = recorded.config.kind
    flown = " flight" if kind in ("simulated", "real") else ""
    said = f"{flight.length_s:.1f} s of {kind}{flown}"
    missing = ", with parts missing" if recorded.remarks else ""
    box = flight_page.verdict_box("failed" if recorded.remarks else "", said + missing, lines)
    return box + html.tiles(summary(recorded, flight, found))


def _losses_section(
    recorded: RecordedFlight, flight: LoggedFlight, found: Sequence[TrackLoss]
) -> str:
    if not (share := seen_share(recorded)):
        said = "No target was ever chosen." if share is None else "The target was never seen."
        return html.section(TITLE, html.paragraph(said))
    pictures, remark, wanted = {}, "", wanted_frames(found)
    if wanted:
        try:
            pictures = pick_images(recorded.pictures(), wanted)
        except FlightFileError as error:
            remark = f"No pictures: {error}."
    return losses_section(found, pictures, flight.start_s, remark)


def inspect_flight(
    folder: Path,
    out: Path | None = None,
    console: Console | None = None,
    *,
    foxglove: Path | None = None,
    rerun: Path | None = None,
) -> Path:
    """Write the report of a flight, print its summary, and return the report's path.

    Args:
        folder: the flight's.
        out: where the report goes; into the flight's folder if not given, or where that has no
            room or must not be written, into the working directory or a new temporary folder.
        console: takes the summary.
        foxglove: where a file for Foxglove goes.
        rerun: where a file for rerun.io goes.

    Raises:
        SettingsError: a viewer's file is wanted, and its package is not installed.
        FlightFileError: the flight cannot be read; one line says why and what could be.
        OSError: the report, or a viewer's file, cannot be written.
    """
    for name, wanted in (("foxglove", foxglove), ("rerun", rerun)):
        if wanted is not None:
            check_extra(f"--{name}", name, name)
    console, recorded = console or Console(), open_flight(folder)
    path = inspect_recorded(recorded, out, console)
    if foxglove is not None:
        from follower.apps.viewers.foxglove_file import write_foxglove

        print_line(console, f"  {write_foxglove(recorded, foxglove)}")
    if rerun is not None:
        from follower.apps.viewers.rerun_file import write_rerun

        print_line(console, f"  {write_rerun(recorded, rerun)}")
    return path


def inspect_recorded(
    recorded: RecordedFlight,
    out: Path | None = None,
    console: Console | None = None,
    more: Sequence[str] = (),
) -> Path:
    """Do the same for a flight that was read already; `more` are sections to add, HTML."""
    goal = _goal(recorded.config) if recorded.truth else None
    flight = LoggedFlight(recorded.log, recorded.truth, goal, _servo(recorded.config))
    found, console = losses(flight), console or Console()
    filmed = any(frame.video_index is not None for frame in recorded.frames)
    if filmed and (problem := video_problem(recorded.folder / VIDEO)):
        recorded.remarks.append(f"{VIDEO}: {problem}.")

    if out is not None:
        check_not_of(recorded, out)

    def written(path: Path) -> Path:
        return write_whole(path, _page(recorded, flight, found, _meta(recorded, path), more))

    try:
        path, remark = written(out or recorded.folder / REPORT), ""
    except OSError as error:
        if out is not None or not is_unwritable(error):
            raise
        path = _elsewhere(recorded, written)
        why = failure_said(error, recorded.folder / REPORT)
        remark = f"The report is not in the flight's folder: {why}"
    _print_summary(console, recorded, flight, found)
    if remark:
        print_line(console, remark, "yellow")
    print_line(console, f"  {path}")
    return path


def _elsewhere(recorded: RecordedFlight, written: Callable[[Path], Path]) -> Path:
    """Write the report where there is room: here, or where temporary files go."""
    name = f"{recorded.folder.resolve().name}-{REPORT}"
    try:
        return written(Path(name))
    except OSError as error:
        if not is_unwritable(error):
            raise
    folder = Path(tempfile.mkdtemp(prefix="follower-"))
    try:
        return written(folder / name)
    except OSError:
        folder.rmdir()
        raise


def _print_summary(
    console: Console, recorded: RecordedFlight, flight: LoggedFlight, found: Sequence[TrackLoss]
) -> None:
    """Write the flight's few figures, its states, and what the recording lacks."""
    table = Table(show_edge=False, pad_edge=False, show_header=False, box=None)
    table.add_column(style="dim")
    table.add_column()
    for name, value in summary(recorded, flight, found):
        table.add_row(name, value)
    console.print(Text(_title(recorded), "bold"))
    console.print(table)
    if flight.states:
        console.print()
        console.print(_states(flight.states))
    for line in _remarks(recorded):
        print_line(console, line, "yellow")
    console.print()


def _states(spans: Sequence[Span]) -> Table:
    table = Table(show_edge=False, pad_edge=False, header_style="dim", box=None)
    table.add_column("From", justify="right")
    table.add_column("For", justify="right")
    table.add_column("State")
    table.add_column("Reason")
    for span in spans[:_MOST_STATES]:
        state = Text(span.state, STATE_STYLES.get(span.state, ""))
        table.add_row(f"{span.start_s:.2f} s", f"{span.length_s:.2f} s", state, span.reason)
    if len(spans) > _MOST_STATES:
        table.add_row("", "", f"… {len(spans) - _MOST_STATES} more", "in the report")
    return table


def _goal(config: FlightConfig) -> PursuitGoal | None:
    """Return what was wanted, None if the settings do not say it in a form known here."""
    elevation_deg = config.number("servo", "elevation_deg")
    if elevation_deg is None:
        elevation_deg = config.number("camera", "pitch_deg") or 0.0
    if config.group("servo").get("mode") == "watch":
        return PursuitGoal(None, None)
    distance_m = config.number("servo", "distance_m")
    try:
        return PursuitGoal(distance_m, math.radians(elevation_deg))
    except ValueError:
        return None


def _servo(config: FlightConfig) -> ServoSettings | None:
    """Return what ranges were taken from, None if the settings do not say it in a known form."""
    said = config.group("servo")
    try:
        return ServoSettings(
            distance_m=said["distance_m"],
            target_size_m=said.get("target_size_m"),
            range_from=RangeFrom(said.get("range_from", RangeFrom.SIZE)),
            target_middle_m=said.get("target_middle_m", 0.0),
        )
    except (KeyError, TypeError, ValueError):
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
        ("Processor", config.processor.get("model", "not recorded")),
        *((name, value) for key, name in _PROCESSOR if (value := config.processor.get(key))),
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
