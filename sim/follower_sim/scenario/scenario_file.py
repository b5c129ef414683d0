"""Reading a scenario file, with errors of one line."""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from follower_control.common.strict_config import (
    SettingsError,
    load_yaml,
    merged,
    parse,
    read_mapping,
)
from follower_sim.scenario.scenario import Scenario

SCENE = "--scene"
"""The option by which single keys get other values."""


def overridden(data: dict[str, Any], overrides: Sequence[str], option: str) -> dict[str, Any]:
    """Return a scenario's mapping with other values; a part of a key that is a number counts.

    Args:
        data: as read from YAML.
        overrides: `key.path=value` each, the value as YAML.
        option: how the user gave them, for errors.

    Raises:
        SettingsError: one is no `key=value`, or counts where there is no list.
    """
    result = copy.deepcopy(data)
    for text in overrides:
        key, separator, value_text = text.partition("=")
        if not separator or not key:
            raise SettingsError(f"{option} {text}: write key=value, for example wind.mean_m_s=6")
        try:
            value = load_yaml(value_text)
        except yaml.YAMLError:
            raise SettingsError(f"{option} {text}: the value is no valid YAML") from None
        _put(result, key.split("."), value, f"{option} {text}")
    return result


def _put(section: Any, parts: Sequence[str], value: Any, source: str) -> None:
    """Put a value where the parts of its key lead, making the sections between."""
    first, *rest = parts
    place: Any = _number(section, first, source) if isinstance(section, list) else first
    if not isinstance(section, dict | list):
        raise SettingsError(f"{source}: there is no section to hold {first!r}")
    if not rest:
        section[place] = value
        return
    if isinstance(section, dict):
        section.setdefault(place, {})
    _put(section[place], rest, value, source)


def _number(section: list[Any], part: str, source: str) -> int:
    if not part.isdecimal() or int(part) >= len(section):
        raise SettingsError(f"{source}: {part!r} is no number from 0 to {len(section) - 1}")
    return int(part)


def load_scenario(path: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario, with other values for single keys.

    Raises:
        SettingsError: the file is missing, is no YAML, or does not describe a scenario.
    """
    data = overridden(read_mapping(path), overrides, SCENE)
    if "targets" not in data and not {"servo", "envelope", "link"}.isdisjoint(data):
        raise SettingsError(f"{path}: these are settings: give them by -c to a scenario's flight")
    said = " ".join(f"{SCENE} {override}" for override in overrides)
    return parse(Scenario, data, f"{path} with {said}" if said else str(path))


def base_settings(scenario: Scenario) -> dict[str, Any]:
    """Return what the settings of a flight in this scenario begin with.

    The camera is what a calibrated follower would know of the scenario's, and the pilot is played.
    """
    camera = scenario.camera
    base = {
        "camera": {
            "fov_deg": camera.fov_deg,
            "pitch_deg": camera.pitch_deg,
            "distortion": list(camera.distortion),
        },
        "autonomy": "full",
    }
    return merged(base, scenario.follow)
