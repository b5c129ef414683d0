"""Flies the golden flights anew, shows what has changed, and puts them in the old ones' place.

    make golden

A golden flight is what vision and control made of the pictures that are in its video: it is flown,
and then replayed from the decoded video and saved, so that the video may be small.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from follower.apps.replay.comparison import compare, print_comparison
from follower.apps.replay.run import replay_flight
from follower.flight.log import FlightLog
from follower.recording import FlightFileError, open_flight
from follower.simulation.options import SimulationOptions
from follower.simulation.run import simulate

HERE = Path("tests", "golden")
"""From the root of the repository, so that no recording names a folder of this machine."""
FLIGHTS = {"chase": "px4", "blackout": "ardupilot", "watch": "ardupilot"}
KEPT = ("flight.mcap", "video.mkv", "config.yaml")


def main() -> None:
    """Renew the flights that are named on the command line, or all."""
    os.chdir(Path(__file__).parents[2])
    console = Console()
    for name in sys.argv[1:] or FLIGHTS:
        with tempfile.TemporaryDirectory() as folder:
            fresh = fly(name, Path(folder))
            show_changes(console, name, fresh)
            shutil.rmtree(HERE / name, ignore_errors=True)
            (HERE / name).mkdir()
            for file in KEPT:
                shutil.copy(fresh / file, HERE / name / file)


def fly(name: str, folder: Path) -> Path:
    """Fly and replay; return the folder of the replayed flight."""
    simulate(
        SimulationOptions(
            str(HERE / f"{name}.yaml"), FLIGHTS[name], lockstep=True, out=folder, video=False
        )
    )
    replay_flight(folder / name, save=True, out=folder)
    return folder / f"{name}-replayed"


def show_changes(console: Console, name: str, fresh: Path) -> None:
    """Print how the new flight differs from the old one, as far as both go."""
    try:
        old = open_flight(HERE / name).log
    except FlightFileError as error:
        console.print(f"{name}: nothing to compare with ({error})", highlight=False)
        return
    new = open_flight(fresh).log
    steps = min(len(old.controls), len(new.controls))
    if len(old.controls) != len(new.controls):
        console.print(f"{name}: {len(new.controls)} control steps, before {len(old.controls)}")
    comparison = compare(_cut(old, steps), _cut(new, steps))
    print_comparison(console, f"{name}, vision before and now", comparison.tracks)
    print_comparison(console, f"{name}, control before and now", comparison.control)


def _cut(log: FlightLog, steps: int) -> FlightLog:
    return replace(log, controls=log.controls[:steps])


if __name__ == "__main__":
    main()
