"""Runs `follower replay`."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console

from follower.apps.replay.comparison import (
    Comparison,
    Strictness,
    compare,
    first_difference,
    pictures_are_exact,
    print_comparison,
)
from follower.apps.replay.replay import Replay, ReplaySaver, replay_settings
from follower.flight.log import FlightLog
from follower.recording import FlightFileError, RecordedFlight, open_flight
from follower.recording.config import INLINE, RECORDED, changed_versions
from follower.recording.recorded_flight import Table, arrays
from follower.recording.run_folder import new_run_folder, write_boxes, write_setpoints
from follower.recording.video_reader import video_problem
from follower.recording.video_writer import VIDEO
from follower.report.series import boxes, control_times, setpoints
from follower.report.style import INK, MUTED, ORANGE, PALETTE, WIDTH_IN
from follower.ui.terminal.console import print_line

SAME, DIFFERENT = 0, 1
OPEN_LOOP = (
    "Open loop: with other settings the flight would have gone another way. Shown is what they "
    "would have asked for at each step of the flight as it was flown."
)
_SHOWN = 8
_CURVES = (
    ("box centre x, px", False, 0),
    ("box scale, px", False, 2),
    ("forward, m/s", True, 0),
    ("up, m/s", True, 2),
    ("yaw rate, °/s", True, 3),
)
"""Label, whether it is of the setpoint or the box, and its column there."""
_RECORDED: dict[str, Any] = {"color": INK.light, "linewidth": 1.6, "label": "recorded"}
_REPLAYED: dict[str, Any] = {
    "color": ORANGE.light,
    "linewidth": 1.0,
    "linestyle": "--",
    "label": "replayed",
}


def write_replay_plot(
    path: Path, recorded: FlightLog, replayed: FlightLog, comparison: Comparison, title: str
) -> None:
    """Draw box and setpoints of both, and the differences on a logarithmic axis.

    Raises:
        OSError: the file cannot be written.
    """
    figure = Figure(figsize=(WIDTH_IN, 11), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(6, 1, sharex=True, height_ratios=[1, 1, 1, 1, 1, 1.6])
    # A folder's name may be no UTF-8, or have what looks like TeX in it.
    figure.suptitle(title.encode("utf-8", "replace").decode(), fontsize=11, parse_math=False)
    for log, style in ((recorded, _RECORDED), (replayed, _REPLAYED)):
        frames_s = [record.captured_s for record in log.tracks]
        steps_s = control_times(log.controls, 0.0)
        box, setpoint = boxes(log.tracks), setpoints(log.controls, "allowed")
        for ax, (label, of_setpoint, column) in zip(axes, _CURVES, strict=False):
            table = setpoint if of_setpoint else box
            ax.plot(steps_s if of_setpoint else frames_s, table[:, column], **style)
            ax.set_ylabel(label)
    _draw_differences(axes[5], comparison)
    axes[-1].set_xlabel("time, s")
    for ax in axes:
        ax.grid(visible=True, color="#e1e5ea")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].legend(loc="upper right", fontsize=8)
    figure.savefig(path, dpi=110)


def _draw_differences(ax: Axes, comparison: Comparison) -> None:
    numbers = [one for one in comparison.differing if one.is_number]
    colours = [colour.light for colour in PALETTE[4:]]
    ax.set_ylabel("difference so far")
    if not numbers:
        ax.text(0.5, 0.5, "no difference", transform=ax.transAxes, ha="center", color=MUTED.light)
        return
    for number, one in enumerate(numbers[:_SHOWN]):
        grown = np.maximum.accumulate(np.where(np.isfinite(one.amounts), one.amounts, 0.0))
        unit = f", {one.unit}" if one.unit else ""
        colour = colours[number % len(colours)]
        shown = np.where(grown > 0, grown, np.nan)
        ax.plot(one.times_s, shown, color=colour, label=f"{one.name}{unit}", linewidth=1.2)
    ax.set_yscale("log")
    ax.legend(fontsize=7, ncols=2, loc="lower right")


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """A replay, beside the flight that it is of.

    Attributes:
        replay: `log` is what came of it, `missed` how many frames vision did not get.
        comparison: how that differs from the recording.
        strictness: what the recording allows to tell.

    Examples:
        >>> import follower
        >>> replayed = follower.replay("runs/demo", vision=False)
        >>> replayed.agrees, replayed.comparison.identical
        (True, True)
        >>> yaw_rate_rad_s = replayed.arrays()["controls"]["allowed_yaw_rate_rad_s"]
    """

    replay: Replay
    comparison: Comparison
    strictness: Strictness

    @property
    def agrees(self) -> bool:
        """Whether nothing differs beyond what the machines' kinds explain."""
        return self.comparison.agrees(self.strictness.tolerance)

    def arrays(self) -> dict[str, Table]:
        """Return the replay's log; see `RecordedFlight.arrays`."""
        return arrays(self.replay.log)


def replayed(
    flight: RecordedFlight,
    overrides: Sequence[str] = (),
    *,
    vision: bool = True,
    saver: ReplaySaver | None = None,
) -> ReplayResult:
    """Replay a flight and compare.

    Args:
        flight: to replay.
        overrides: settings to replay with, as `key=value`.
        vision: from the recorded frames; else control alone, from the recorded tracks.
        saver: keeps the replay.

    Raises:
        FlightFileError: the video cannot be read, or the recording contradicts itself.
        SettingsError: an override cannot be used.
    """
    replay = Replay(
        flight,
        replay_settings(flight, overrides),
        own_camera=not any(text.startswith("camera.") for text in overrides),
        tracks_recorded=not vision,
        on_message=saver,
        sink=saver,
    )
    return ReplayResult(replay, compare(flight.log, replay.run()), Strictness.of(flight))


def replay_flight(
    folder: Path, overrides: Sequence[str] = (), save: bool = False, out: Path = Path("runs")
) -> int:
    """Replay, print what is different, write plots of it, and return the exit code.

    Args:
        folder: of the flight.
        overrides: settings to replay with, as `key=value`.
        save: keep the replay as a flight of its own.
        out: takes the folders of what is written.

    Raises:
        FlightFileError: the flight cannot be read.
        SettingsError: an override cannot be used.
    """
    console = Console()
    # As in the flight; and the number of threads must not decide about the last bit.
    cv2.setNumThreads(1)
    flight = open_flight(folder)
    settings = replay_settings(flight, overrides)
    if overrides:
        print_line(console, f"With {', '.join(overrides)}. {OPEN_LOOP}")
    with console.status("Replaying control"):
        control = replayed(flight, overrides, vision=False)
    allowed = control.strictness.tolerance
    print_comparison(
        console, "Control from the recorded tracks", control.comparison.control, allowed
    )
    whole, saver = None, None
    unread = video_problem(flight.folder / VIDEO)
    if unread is None:
        if save:
            copy = new_run_folder(out, f"{flight.folder.resolve().name}-replayed")
            saver = ReplaySaver(flight, copy, settings, overrides)
            print_line(console, f"It is saved as a flight of its own: {copy}")
        with console.status("Replaying vision and control"), saver or nullcontext():
            whole = replayed(flight, overrides, saver=saver)
        print_comparison(
            console, "Vision from the recorded frames", whole.comparison.tracks, allowed
        )
        if any(one.largest > allowed for one in whole.comparison.tracks):
            print_comparison(console, "Control from those tracks", whole.comparison.control)
    elif save:
        raise FlightFileError(f"--save needs the video, and {VIDEO} cannot be read: {unread}")
    for remark in flight.remarks:
        print_line(console, remark)
    if unread is not None:
        print_line(console, f"{VIDEO} cannot be read ({unread}): vision was not replayed.")
    if not flight.log.controls and (whole is None or not flight.log.tracks):
        print_line(console, "There was nothing to compare.", "red")
        return DIFFERENT
    return _conclude(flight, control, whole, overrides, out, console)


def _conclude(
    flight: RecordedFlight,
    control: ReplayResult,
    whole: ReplayResult | None,
    overrides: Sequence[str],
    out: Path,
    console: Console,
) -> int:
    """Say whether what is guaranteed holds, and write down what differs."""
    best, strictness, caveat = whole or control, control.strictness, _caveat(flight, whole)
    if overrides or not (best.agrees and control.agrees):
        strictly = "" if caveat else f", compared {strictness}"
        how = f" with {', '.join(overrides)}, open loop" if overrides else strictly
        _write(flight, best, how, out, console)
    if overrides:
        return SAME
    print_line(console, strictness.why)
    guaranteed = control if caveat else best
    if guaranteed.agrees and control.agrees:
        same = "Control replays" if caveat else "The replay is identical to the flight,"
        what = f"{same} {strictness}."
        if caveat and not flight.log.controls:
            what = "There was no control step to compare."
        console.print(f"[green]{what}[/green]{caveat}", highlight=False)
        return SAME
    for line in (
        first_difference(guaranteed.comparison),
        *changed_versions(flight.config.versions),
    ):
        print_line(console, line)
    console.print("[red]The replay differs from the flight.[/red]")
    return DIFFERENT


def _caveat(flight: RecordedFlight, whole: ReplayResult | None) -> str:
    """Say why vision's answers need not be the recorded ones, "" if they have to be."""
    if whole is None:
        return " Vision was not replayed."
    run = flight.config.run
    detection = run.get("detection", INLINE)
    detects = flight.config.settings.get("detector") or run.get("detector")
    if detection not in (INLINE, RECORDED) and detects:
        return f" Vision was not compared strictly: detection was {detection}, with its own time."
    if whole.replay.missed:
        missed = whole.replay.missed
        return f" Vision was not compared strictly: {missed} frames are not in the video."
    if not pictures_are_exact(flight):
        return (
            " Vision was not compared strictly: the video is lossy, what is decoded from it is "
            "not quite what vision saw. --save makes a reference from the decoded frames."
        )
    if not whole.strictness.is_exact:
        return (
            " Vision was not compared strictly: a tracker's rounding errors grow, and they are "
            "others on another kind of machine."
        )
    return ""


def _write(
    flight: RecordedFlight, outcome: ReplayResult, how: str, out: Path, console: Console
) -> None:
    name, log = flight.folder.resolve().name, outcome.replay.log
    folder = new_run_folder(out, f"replay-{name}")
    files = [folder / file for file in ("replay.png", "boxes.csv", "setpoints.csv")]
    write_replay_plot(files[0], flight.log, log, outcome.comparison, f"{name}, replayed{how}")
    write_boxes(files[1], log.tracks)
    write_setpoints(files[2], log.controls)
    for file in files:
        print_line(console, f"  {file}")
