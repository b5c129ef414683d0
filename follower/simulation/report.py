"""What is written and said of a simulated flight when it is over."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path

from rich.console import Console

from follower.outputs import write_boxes, write_setpoints
from follower.print_line import print_line
from follower.report.meta import ReportMeta
from follower.report.writer import write_report, write_score, write_whole
from follower.sight import Sight
from follower.simulated_flight import SimulatedFlight
from follower.simulation_options import SimulationOptions
from follower.terminal import print_score
from follower_sim.criteria import verdict
from follower_sim.stand_in import LABEL

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


def report_flight(
    flight: SimulatedFlight,
    options: SimulationOptions,
    folder: Path,
    remarks: tuple[str, ...],
    console: Console,
) -> bool:
    """Write everything, say what came of it, and return whether the scenario's limits are met."""
    criteria, score = flight.scenario.expect, flight.score()
    write_boxes(folder / "boxes.csv", flight.log.tracks)
    write_setpoints(folder / "setpoints.csv", flight.log.controls)
    write_whole(folder / "settings.yaml", flight.settings.to_yaml())
    run = {
        "scenario": flight.scenario.name,
        "autopilot": options.autopilot,
        "seed": flight.seed,
        "vision": str(options.sight),
    }
    write_score(folder, score, criteria, run)
    write_report(
        folder,
        flight.log,
        _meta(flight, options, remarks),
        truth=flight.truth,
        goal=flight.goal,
        score=score,
        criteria=criteria,
        target_size_m=flight.settings.servo.target_size_m,
    )
    files = [folder / name for name, _ in FILES if (folder / name).exists()]
    print_score(console, score, criteria, files)
    for remark in remarks:
        print_line(console, remark)
    return not verdict(score, criteria)


def _meta(
    flight: SimulatedFlight, options: SimulationOptions, remarks: tuple[str, ...]
) -> ReportMeta:
    how = "lockstep" if options.lockstep else "real time"
    how += f" · {LABEL}" if options.sight is Sight.TRUTH else ""
    kind = flight.settings.link.kind
    link = "through memory" if options.lockstep else f"by {kind}, {options.connect}"
    return ReportMeta(
        title=flight.scenario.title,
        subtitle=f"{flight.scenario.name} · {options.autopilot} · seed {flight.seed} · {how}",
        command=options.command,
        settings_yaml=flight.settings.to_yaml(),
        facts=(
            ("Version", version("drone-target-follower")),
            ("Python", sys.version.split()[0]),
            ("Autopilot", options.autopilot),
            ("Link", f"MAVLink 2 {link}"),
            ("Link at the end", flight.link_status.line()),
            ("Vision", NO_PIXELS if options.sight is Sight.TRUTH else flight.settings.tracker),
            ("Seed", str(flight.seed)),
        ),
        files=FILES,
        video=VIDEO if options.video else "",
        remarks=remarks,
    )
