"""Runs `follower replay`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
from rich.console import Console

from follower.outputs import write_boxes, write_setpoints
from follower.print_line import print_line
from follower.recorder import FlightFileError, RecordedFlight, open_flight
from follower.recorder.video_queue import VIDEO
from follower.recorder.video_reading import video_problem
from follower.replay.comparison import Comparison, compare
from follower.replay.replay import Replay, replay_settings
from follower.replay.saving import ReplaySaver
from follower.replay.verdict import (
    changed_versions,
    first_difference,
    pictures_are_exact,
    print_comparison,
)
from follower.report.replay_plot import write_replay_plot
from follower.run_folder import new_run_folder
from follower.settings import Settings

SAME, DIFFERENT = 0, 1
OPEN_LOOP = (
    "Open loop: with other settings the flight would have gone another way. Shown is what they "
    "would have asked for at each moment of the flight as it was flown."
)


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What the command line was given; see `follower replay --help`."""

    flight: Path
    overrides: tuple[str, ...] = ()
    save: bool = False
    out: Path = Path("runs")


@dataclass(frozen=True, slots=True, eq=False)
class _Outcome:
    """A replay, beside the flight that it is of."""

    replay: Replay
    comparison: Comparison


def replay_flight(options: ReplayOptions) -> int:
    """Replay, print what is different, write plots of it, and return the exit code.

    Raises:
        FlightFileError: the flight cannot be read.
        SettingsError: an override cannot be used.
    """
    console = Console()
    # As in the flight; and the number of threads must not decide about the last bit.
    cv2.setNumThreads(1)
    flight = open_flight(options.flight)
    settings = replay_settings(flight, options.overrides)
    if options.overrides:
        print_line(console, f"With {', '.join(options.overrides)}. {OPEN_LOOP}")
    with console.status("Replaying control"):
        control = _control_alone(options, flight, settings)
    print_comparison(console, "Control from the recorded tracks", control.comparison.control)
    whole = None
    unread = video_problem(flight.folder / VIDEO)
    if unread is None:
        with console.status("Replaying vision and control"):
            whole = _whole(options, flight, settings, console)
        print_comparison(console, "Vision from the recorded frames", whole.comparison.tracks)
        if any(one.count for one in whole.comparison.tracks):
            print_comparison(console, "Control from those tracks", whole.comparison.control)
    elif options.save:
        raise FlightFileError(f"--save needs the video, and {VIDEO} cannot be read: {unread}")
    for remark in flight.remarks:
        print_line(console, remark)
    if unread is not None:
        print_line(console, f"{VIDEO} cannot be read ({unread}): vision was not replayed.")
    if not flight.log.controls and (whole is None or not flight.log.tracks):
        print_line(console, "There was nothing to compare.", "red")
        return DIFFERENT
    return _conclude(options, flight, control, whole, console)


def _control_alone(options: ReplayOptions, flight: RecordedFlight, settings: Settings) -> _Outcome:
    own = _own_camera(options)
    replay = Replay(flight, settings, own_camera=own, tracks_recorded=True)
    return _Outcome(replay, compare(flight.log, replay.run()))


def _whole(
    options: ReplayOptions, flight: RecordedFlight, settings: Settings, console: Console
) -> _Outcome:
    own = _own_camera(options)
    if not options.save:
        replay = Replay(flight, settings, own_camera=own)
        return _Outcome(replay, compare(flight.log, replay.run()))
    folder = new_run_folder(options.out, f"{flight.folder.resolve().name}-replayed")
    with ReplaySaver(flight, folder, settings, options.overrides) as saver:
        replay = Replay(flight, settings, own_camera=own, on_message=saver, sink=saver)
        replay.run()
    print_line(console, f"Saved as a flight of its own: {folder}")
    return _Outcome(replay, compare(flight.log, replay.log))


def _own_camera(options: ReplayOptions) -> bool:
    return not any(text.startswith("camera.") for text in options.overrides)


def _conclude(
    options: ReplayOptions,
    flight: RecordedFlight,
    control: _Outcome,
    whole: _Outcome | None,
    console: Console,
) -> int:
    """Say whether what is guaranteed holds, and write down what differs."""
    best = whole or control
    if options.overrides or not best.comparison.identical or not control.comparison.identical:
        _write(options, flight, best, console)
    if options.overrides:
        return SAME
    caveat = _caveat(flight, whole)
    guaranteed = control if caveat else best
    if guaranteed.comparison.identical and control.comparison.identical:
        what = "Control replays" if caveat else "The replay is identical to the flight,"
        console.print(f"[green]{what} bit for bit.[/green]{caveat}", highlight=False)
        return SAME
    for line in (first_difference(guaranteed.comparison), *changed_versions(flight)):
        print_line(console, line)
    console.print("[red]The replay differs from the flight.[/red]")
    return DIFFERENT


def _caveat(flight: RecordedFlight, whole: _Outcome | None) -> str:
    """Say why vision's answers need not be the recorded ones, "" if they have to be."""
    if whole is None:
        return " Vision was not replayed."
    detection = flight.config.run.get("detection", "inline")
    if detection != "inline" and flight.config.settings.get("detector"):
        return f" Vision was not compared strictly: detection was {detection}, with its own time."
    if whole.replay.missed:
        missed = whole.replay.missed
        return f" Vision was not compared strictly: {missed} frames are not in the video."
    if not pictures_are_exact(flight):
        return (
            " Vision was not compared strictly: the video is lossy, what is decoded from it is "
            "not quite what vision saw. --save makes a reference from the decoded frames."
        )
    return ""


def _write(
    options: ReplayOptions, flight: RecordedFlight, outcome: _Outcome, console: Console
) -> None:
    name = flight.folder.resolve().name
    folder = new_run_folder(options.out, f"replay-{name}")
    plot = folder / "replay.png"
    how = f" with {', '.join(options.overrides)}, open loop" if options.overrides else ""
    title = f"{name}, replayed{how}"
    log = outcome.replay.log
    write_replay_plot(plot, flight.log, log, outcome.comparison, title)
    write_boxes(folder / "boxes.csv", log.tracks)
    write_setpoints(folder / "setpoints.csv", log.controls)
    for file in (plot, folder / "boxes.csv", folder / "setpoints.csv"):
        print_line(console, f"  {file}")
