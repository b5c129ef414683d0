"""The hidden car, flown in lockstep with Fusion and the networks that come along."""

from pathlib import Path

import pytest

from follower.settings.settings import load_settings
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

FILE = Path(__file__).parents[3] / "configs" / "scenarios" / "demo.yaml"


@pytest.mark.slow
def test_the_hidden_car_is_found_again_and_the_other_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path))  # as on a machine without any download
    scenario, clock = load_scenario(FILE), SimulatedClock()
    settings = load_settings(base=base_settings(scenario))
    flight = SimulatedFlight(World(scenario), settings, "px4", clock, MemoryTransport.pair())
    fly_lockstep(flight, clock, lambda: None)
    flight.close()
    identity = flight.ground_truth.identity
    assert identity.disappearances == 1
    assert 2.5 < identity.longest_hidden_s < 5
    assert identity.never_found == 0
    assert identity.slowest_found_s is not None
    assert identity.slowest_found_s < 1.0
    assert identity.mistaken_s == 0
