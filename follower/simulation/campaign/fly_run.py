"""Flies one run of a campaign; this is what workers are sent."""

from __future__ import annotations

import time
from contextlib import closing
from importlib.metadata import version
from typing import Any

import cv2

from follower.campaign.figures import Figures, figures_of
from follower.campaign.run_spec import RunSpec
from follower.configs import find_scenario
from follower.flight_extras import FlightExtras
from follower.flying import fly_lockstep
from follower.sight import Sight, check_without_pixels
from follower.simulate import simulation_settings
from follower.simulated_flight import SimulatedFlight
from follower_control.transport import MemoryTransport
from follower_sim.scenario_file import load_scenario
from follower_sim.world import World
from follower_vision.clock import SimulatedClock

TIMING = ("wall_s",)
"""What differs from one time to the next, of all that a row says."""


def fly_run(spec: RunSpec) -> dict[str, Any]:
    """Fly a run on this thread alone, and return its row: what it was, what came of it.

    Raises:
        SettingsError: the scenario or a setting cannot be used.
    """
    cv2.setNumThreads(1)
    begin_s = time.perf_counter()
    figures = _flown(spec)
    row = {**row_of(spec), **figures.to_dict()}
    return {**row, "wall_s": time.perf_counter() - begin_s}


def row_of(spec: RunSpec, error: str = "") -> dict[str, Any]:
    """Return what is known of a run before it is flown."""
    return {
        "key": spec.key,
        "number": spec.number,
        "scenario": spec.scenario,
        "autopilot": spec.autopilot,
        "seed": spec.seed,
        "vision": spec.sight,
        "values": dict(spec.values),
        "command": spec.command,
        "version": version("drone-target-follower"),
        "error": error,
    }


def _flown(spec: RunSpec) -> Figures:
    options = spec.options()
    scenario = load_scenario(find_scenario(spec.scenario), spec.scene)
    if options.sight is Sight.TRUTH:
        check_without_pixels(scenario)
    settings = simulation_settings(scenario, options)
    clock, ends = SimulatedClock(), MemoryTransport.pair()
    world = World(scenario, spec.seed)
    flight = SimulatedFlight(
        world, settings, spec.autopilot, clock, ends, FlightExtras(sight=options.sight)
    )
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    return figures_of(flight)[0]
