"""Reading a scenario file, with errors of one line."""

from __future__ import annotations

from pathlib import Path

from follower_control.strict_yaml import parse, read_mapping
from follower_sim.scenario import Scenario


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario.

    Raises:
        SettingsError: the file is missing, is no YAML, or does not describe a scenario.
    """
    return parse(Scenario, read_mapping(path), str(path))
