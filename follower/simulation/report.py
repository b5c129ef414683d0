"""The files and the printed score of a simulated flight that is over."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from follower.flight.log import failed_plugins
from follower.flight.supervision.flight_end import (
    HANDED_OVER,
    INTERRUPTED,
    SUCCESS,
    FlightEnd,
    pursuit_end,
)
from follower.recording.run_folder import RunFiles, write_boxes, write_setpoints
from follower.report.flight_page import REPORT, SCORE, write_report, write_score
from follower.report.series import ReportMeta
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import VisionSource
from follower.ui.terminal.console import print_line
from follower_sim.noisy_tracker import LABEL
from follower_sim.scenario.scenario import Criteria
from follower_sim.scoring.criteria import checks, verdict
from follower_sim.scoring.score import PursuitScore
from follower_vision.disk import write_whole

_STYLES = {SUCCESS: "bold green", HANDED_OVER: "bold yellow", INTERRUPTED: "bold yellow"}
NO_PIXELS = LABEL[0].upper() + LABEL[1:]
VIDEO = "overlay.mp4"
FILES = (
    ("report.html", "this report"),
    (VIDEO, "to watch: what the camera saw, with the track drawn into it"),
    ("flight.mcap", "the recording: every message, for `follower replay`, Foxglove, PlotJuggler"),
    ("mavlink.tlog", "the recording: every MAVLink packet, for Mission Planner and MAVProxy"),
    ("video.mkv", "the recording: the frames that vision saw, nothing drawn into them"),
    ("config.yaml", "the recording: settings, versions, hashes of networks, seed"),
    ("score.json", "the score and its limits"),
    ("boxes.csv", "the track, a line a frame"),
    ("setpoints.csv", "the setpoints, a line a control step"),
    ("settings.yaml", "the settings as resolved"),
)
_PROGRAMS_FILES = (
    ("autopilot.bin", "ArduPilot's own log, for UAV Log Viewer and MAVExplorer"),
    ("autopilot.ulg", "PX4's own log, for Flight Review and PlotJuggler"),
    ("autopilot.csv", "the simulated autopilot's own log"),
    ("autopilot.txt", "what the autopilot's program wrote to its terminal"),
)


def print_score(
    console: Console,
    score: PursuitScore,
    criteria: Criteria,
    files: Sequence[Path],
    end: FlightEnd,
) -> None:
    """Write the score with its limits, the end, and the files."""
    table = Table(show_edge=False, pad_edge=False, header_style="dim")
    table.add_column("Figure")
    table.add_column("Value", justify="right")
    table.add_column("Limit", justify="right")
    table.add_column("")
    marks = {True: Text("passed", "green"), False: Text("failed", "bold red"), None: Text("")}
    for check in checks(score, criteria):
        table.add_row(check.name, check.value, check.limit, marks[check.passed])
    console.print(table)
    console.print()
    console.print(Text(end.sentence, _STYLES.get(end.exit_code, "bold red")))
    for line in verdict(score, criteria) if end.exit_code != HANDED_OVER else ():
        print_line(console, f"  {line}")
    for path in files:
        print_line(console, f"  {path}")


def report_flight(
    flight: SimulatedFlight,
    score: PursuitScore,
    folder: Path,
    command: str,
    autopilot: str,
    connection: str,
    remarks: tuple[str, ...],
    console: Console,
    end: FlightEnd | None = None,
) -> FlightEnd:
    """Write all files of a flight, print its score, return how it ended.

    Args:
        flight: is over.
        score: of the flight.
        folder: where the files go.
        command: the command line that flies it again.
        autopilot: which one flew, with its version if that is known.
        connection: over which MAVLink was spoken, in words.
        remarks: what the reader has to know.
        console: where the score is printed.
        end: how it ended, if not as the flight itself tells it.
    """
    criteria, failed = flight.scenario.expect, failed_plugins(flight.log)
    end = end or flight.end
    if end.exit_code == SUCCESS:
        end = pursuit_end([*verdict(score, criteria), *failed])
    written = RunFiles(folder)
    written.write("boxes.csv", lambda path: write_boxes(path, flight.log.tracks))
    written.write("setpoints.csv", lambda path: write_setpoints(path, flight.log.controls))
    written.write("settings.yaml", lambda path: write_whole(path, flight.settings.to_yaml()))
    run = {
        "scenario": flight.scenario.name,
        "autopilot": autopilot,
        "seed": flight.seed,
        "vision": str(flight.vision_source),
        "end": end.sentence,
    }
    written.write(SCORE, lambda path: write_score(path.parent, score, criteria, run))
    meta = replace(_meta(flight, folder, command, autopilot, connection, remarks), end=end)
    written.write(
        REPORT,
        lambda path: write_report(
            path.parent,
            flight.log,
            meta,
            truth=flight.truth,
            goal=flight.goal,
            score=score,
            criteria=criteria,
            servo=flight.settings.servo,
        ),
    )
    files = [folder / name for name, _ in (*FILES, *_PROGRAMS_FILES) if (folder / name).exists()]
    print_score(console, score, criteria, files, end)
    for remark in (*failed, *remarks, *written.remarks):
        print_line(console, remark)
    return end


def _meta(
    flight: SimulatedFlight,
    folder: Path,
    command: str,
    autopilot: str,
    connection: str,
    remarks: tuple[str, ...],
) -> ReportMeta:
    without_pixels = flight.vision_source is VisionSource.TRUTH
    how = f"{flight.pace} · {LABEL}" if without_pixels else flight.pace
    return ReportMeta(
        title=flight.scenario.title,
        subtitle=f"{flight.scenario.name} · {autopilot} · seed {flight.seed} · {how}",
        command=command,
        settings_yaml=flight.settings.to_yaml(),
        facts=(
            ("Version", version("drone-target-follower")),
            ("Python", sys.version.split()[0]),
            ("Autopilot", autopilot),
            ("Link", f"MAVLink 2 {connection}"),
            ("Link at the end", flight.link_status.line()),
            ("Vision", NO_PIXELS if without_pixels else flight.settings.tracker),
            ("Seed", str(flight.seed)),
        ),
        files=(*FILES, *(row for row in _PROGRAMS_FILES if (folder / row[0]).exists())),
        video=VIDEO if (folder / VIDEO).exists() else "",
        remarks=remarks,
    )
