"""Flies the runs of a campaign, each to a row."""

import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from importlib.metadata import version
from typing import Any

import cv2
from rich.console import Console

from follower.simulation.campaign.config import RunSpec, contents_of
from follower.simulation.campaign.metrics import figures_of
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower.ui.terminal.console import print_line
from follower.workers import Engine
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

INTERRUPTED = 130
STOPPED = "Stopped; what is finished is kept, and the same command goes on."


def fly_runs(engine: Engine, specs: Sequence[RunSpec]) -> Iterator[dict[str, Any]]:
    """Yield a row for each run as it is finished; one that failed has a row that says why."""
    for done in engine.run(fly_run, specs):
        yield row_of(done.job, done.failure) if done.failure else done.result


def fly_run(spec: RunSpec) -> dict[str, Any]:
    """Fly a run on this thread alone, and return its row: what it was, what came of it.

    Raises:
        SettingsError: the scenario or a setting cannot be used, or the files are not those that
            were planned with: edited meanwhile, or others on this computer.
    """
    if spec.contents not in ("", contents_of(spec.scenario, spec.config)):
        files = " or ".join(filter(None, (spec.scenario, spec.config)))
        raise SettingsError(f"{files} is not what it was when the campaign began; begin it again")
    cv2.setNumThreads(1)
    begin_s = time.perf_counter()
    options = spec.options()
    scenario, settings = options.resolve()
    clock, ends = SimulatedClock(), MemoryTransport.pair()
    world, extras = World(scenario, spec.seed), FlightOptions(vision=options.vision)
    flight = SimulatedFlight(world, settings, spec.autopilot, clock, ends, extras)
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    figures = figures_of(flight).to_dict()
    return {**row_of(spec), **figures, "wall_s": time.perf_counter() - begin_s}


def row_of(spec: RunSpec, error: str = "") -> dict[str, Any]:
    """Return what is known of a run before it is flown."""
    return {
        "key": spec.key,
        "number": spec.number,
        "scenario": spec.scenario,
        "autopilot": spec.autopilot,
        "seed": spec.seed,
        "vision": spec.vision,
        "values": dict(spec.values),
        "command": spec.options().command,
        "version": version("drone-target-follower"),
        "error": error,
    }


def print_errors(errors: Sequence[str], runs: int, console: Console) -> None:
    """Say how many of the runs could not be flown, and why the first one; nothing if all could."""
    if errors:
        text = f"{len(errors)} of {runs} runs could not be flown, the first one: {errors[0]}"
        print_line(console, text, "bold red")
