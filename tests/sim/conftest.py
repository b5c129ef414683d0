"""A small world that is quick to make."""

from collections.abc import Callable
from typing import Any

import pytest

from follower_sim.scenario.scenario import Scenario
from follower_sim.world.world import World


def small_scenario(**changes: Any) -> Scenario:
    """Return a scenario with a car that stands 15 m north of the start."""
    data: dict[str, Any] = {
        "name": "small",
        "title": "A car stands in a meadow.",
        "duration_s": 20,
        "seed": 5,
        "targets": [
            {"kind": "car", "colour": "#e0401c", "path": {"points": [[15, 0], [25, 0]]}},
        ],
        "camera": {"width": 320, "height": 240, "exposure_s": 0.0},
        "start": {"at": [0, 0]},
        "select": {"colour": "#e0401c"},
    }
    return Scenario.model_validate({**data, **changes})


@pytest.fixture(scope="session")
def make_world() -> Callable[..., World]:
    """Return what makes a world like `small_scenario`, with other settings where given."""
    return lambda **changes: World(small_scenario(**changes))


@pytest.fixture(scope="session")
def small_world() -> World:
    return World(small_scenario())
