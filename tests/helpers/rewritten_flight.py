"""Copies of recorded flights whose log says something else."""

import shutil
from collections.abc import Callable
from pathlib import Path

from follower.recording import open_flight
from follower.recording.mcap_writer import McapLog


def logged_anew(recorded: Path, folder: Path, change: Callable[[object], object | None]) -> Path:
    """Copy a flight; `change` returns what is logged in a message's place, None for nothing."""
    flight = open_flight(recorded)
    shutil.copytree(recorded, folder)
    (folder / "flight.mcap").unlink()
    with McapLog(folder / "flight.mcap", flight.config.epoch_ns, flight.config.to_yaml()) as log:
        for time_s, message in flight.messages():
            changed = change(message)
            if changed is not None:
                log.write(changed, time_s)
    return folder
