"""A small world that is quick to make."""

from collections.abc import Callable
from typing import Any

import pytest
import yaml
from small_scenario import small_scenario

from follower_sim.scenario.scenario import Scenario
from follower_sim.world.world import World


def changed_scenario(**changes: Any) -> Scenario:
    """Return a scenario with a car that stands 15 m north of the start."""
    return Scenario.model_validate(yaml.safe_load(small_scenario(20)) | changes)


@pytest.fixture(scope="session")
def make_world() -> Callable[..., World]:
    """Return what makes a world like `changed_scenario`, with other settings where given."""
    return lambda **changes: World(changed_scenario(**changes))


@pytest.fixture(scope="session")
def small_world() -> World:
    return World(changed_scenario())
