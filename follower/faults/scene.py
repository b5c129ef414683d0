"""The flight into which faults are put: a car that drives past a small camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from follower_sim.scenario import Scenario

TARGET_SPEED_M_S = 3.5
DISTANCE_M = 14.0

_SCENE: dict[str, Any] = {
    "name": "fault",
    "title": "A car drives along a meadow, and something goes wrong.",
    "duration_s": 30,
    "seed": 3,
    "targets": [
        {
            "kind": "car",
            "colour": "#e0401c",
            "path": {
                "points": [[0, 0], [60, 5], [160, 0]],
                "speeds": [{"at_s": 8, "speed_m_s": TARGET_SPEED_M_S, "acceleration_m_s2": 1.5}],
            },
        }
    ],
    "camera": {"width": 320, "height": 240, "fov_deg": 90, "pitch_deg": -14, "rate_hz": 15},
    "start": {"at": [-18, 0]},
    "takeoff_height_m": 6,
    "select": {"colour": "#e0401c", "search": {"max_growth_ratio": 0.1}},
    "follow": {
        "servo": {"distance_m": DISTANCE_M, "target_size_m": 2.2, "elevation_deg": -25},
        "supervisor": {"search_s": 2.0},
    },
}


def write_scene(folder: Path) -> Path:
    """Write the scenario into a file, for another process, and return its path."""
    path = folder / "fault.yaml"
    path.write_text(yaml.safe_dump(_SCENE), "utf-8")
    return path


def scene() -> Scenario:
    """Return the scenario: follows after 6 s, ends after 30 s."""
    return Scenario.model_validate(_SCENE)
