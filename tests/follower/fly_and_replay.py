"""Flies without pixels, replays a golden flight's control, and prints what was computed.

Run by test_processors.py in processes of its own.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.log import ControlRecord
from follower.recording import open_flight
from follower.recording.config import running_processor
from follower.settings.settings import find_scenario, load_settings
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import VisionSource
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock


def flown(name: str, seconds: float) -> Iterable[ControlRecord]:
    scenario = load_scenario(find_scenario(name), (f"duration_s={seconds}",))
    world, clock, extras = (
        World(scenario),
        SimulatedClock(),
        FlightOptions(vision=VisionSource.TRUTH),
    )
    settings, ends = load_settings(base=base_settings(scenario)), MemoryTransport.pair()
    with closing(SimulatedFlight(world, settings, "px4", clock, ends, extras)) as flight:
        fly_lockstep(flight, clock, lambda: None)
        return flight.log.controls


def replayed(folder: Path) -> Iterable[ControlRecord]:
    flight = open_flight(folder)
    return Replay(flight, replay_settings(flight), tracks_recorded=True).run().controls


def digest(records: Iterable[ControlRecord]) -> str:
    sha = hashlib.sha256()
    for record in records:
        estimate = record.estimate
        covariance = b"" if estimate is None else estimate.covariance.tobytes()
        said = (record.time_s, record.asked.values, record.allowed.values, str(record.state))
        sha.update(repr(said).encode() + covariance)
    return sha.hexdigest()


def main() -> None:
    golden = Path(sys.argv[1])
    print(running_processor()["blas"])
    print(digest(replayed(golden)))
    for name in ("winding", "windy"):
        print(digest(flown(name, 12.0)))


if __name__ == "__main__":
    main()
