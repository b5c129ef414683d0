"""Reading a scenario file, with errors of one line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from follower_control.strict_yaml import parse, read_mapping
from follower_sim.scenario import Scenario
from follower_sim.scene_overrides import overridden

SCENE = "--scene"
"""The option by which single keys get other values."""


def load_scenario(path: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario, with other values for single keys.

    Raises:
        SettingsError: the file is missing, is no YAML, or does not describe a scenario.
    """
    data = overridden(read_mapping(path), overrides, SCENE)
    source = f"{path} with {SCENE} {overrides[-1]}" if overrides else str(path)
    return parse(Scenario, data, source)
