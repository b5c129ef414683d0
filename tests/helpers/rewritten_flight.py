"""Copies of recorded flights whose log or configuration says something else."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from follower.recording import open_flight
from follower.recording.mcap_writer import McapLog


def logged_anew(recorded: Path, folder: Path, change: Callable[[object], object | None]) -> Path:
    """Copy a flight; `change` returns what is logged in a message's place, None for nothing."""
    return _written_anew(recorded, folder, change, lambda _config: None)


def configured_anew(recorded: Path, folder: Path, edit: Callable[[dict[str, Any]], None]) -> Path:
    """Copy a flight; `edit` alters its configuration, in the file and in the log's copy."""
    return _written_anew(recorded, folder, lambda message: message, edit)


def _written_anew(
    recorded: Path,
    folder: Path,
    change: Callable[[object], object | None],
    edit: Callable[[dict[str, Any]], None],
) -> Path:
    flight = open_flight(recorded)
    shutil.copytree(recorded, folder)
    (folder / "flight.mcap").unlink()
    config = yaml.safe_load(flight.config.to_yaml())
    edit(config)
    text = yaml.safe_dump(config)
    (folder / "config.yaml").write_text(text, "utf-8")
    with McapLog(folder / "flight.mcap", flight.config.epoch_ns, text) as log:
        for time_s, message in flight.messages():
            changed = change(message)
            if changed is not None:
                log.write(changed, time_s)
    return folder
