"""How a scenario's flight begins: where things stand, and what the follower is set to."""

from __future__ import annotations

import math
from typing import Any

from follower.settings import merged
from follower_sim.gimbal import Gimbal
from follower_sim.kinematics import BodyState
from follower_sim.scenario import Scenario


def start_state(scenario: Scenario) -> BodyState:
    """Return where the vehicle stands at first."""
    north, east = scenario.start.at
    heading = math.radians(scenario.start.heading_deg)
    return BodyState(0.0, (north, east, 0.0), attitude_rad=(0.0, 0.0, heading))


def gimbal_of(scenario: Scenario) -> Gimbal | None:
    """Return the gimbal that holds the scenario's camera, None if it is fixed."""
    camera = scenario.camera
    if camera.gimbal is None:
        return None
    heading = math.radians(scenario.start.heading_deg)
    return Gimbal(camera.gimbal, math.radians(camera.pitch_deg), heading, 0.0)


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
