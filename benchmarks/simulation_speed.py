"""How much faster than real time flights are simulated on one core, with and without pixels.

    python benchmarks/simulation_speed.py [SCENARIO] [SECONDS]

The scenario (`winding` unless told) is flown in lockstep for so many simulated seconds (40 unless
told): once with its camera rendered, all imperfections on, at the size that the scenario says and
followed by the default tracker; once with the truth + noise in vision's place; and, as `follower
faults --random` does it, with a cheap vehicle and random faults. Nothing is recorded or filmed.
Counted is the processor's time of this one thread, building the world left out, of the fastest of
three times, for other work on the machine makes it longer; the wall's is beside it. Measured:
docs/decisions/0003-lockstep-in-memory.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import command_line
import cv2

from follower.settings.settings import find_scenario, load_settings
from follower.simulation.components import FlightOptions
from follower.simulation.fault_tests.random_flight import STEP_S, fly_random
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import VisionSource
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

SECONDS = 40.0
RANDOM_FLIGHTS = 8
TIMES = 3


@dataclass(frozen=True, slots=True)
class Speed:
    """What one flight took: simulated, processor's and wall's seconds, and control steps."""

    name: str
    simulated_s: float
    processor_s: float
    wall_s: float
    steps: int

    def line(self) -> str:
        """Return it as a line of the table."""
        return (
            f"{self.name:32}{self.simulated_s:9.1f}{self.processor_s:9.2f}"
            f"{self.simulated_s / self.processor_s:10.1f}x{self.simulated_s / self.wall_s:9.1f}x"
            f"{self.steps / self.processor_s:10.0f}"
        )


def timed(name: str, prepare: Callable[[], Callable[[], tuple[float, int]]]) -> Speed:
    """Return what the fastest of some equal flights took.

    `prepare` returns what flies one and returns its simulated seconds and its control steps.
    """
    speeds = []
    for _ in range(TIMES):
        fly = prepare()
        wall, processor = time.perf_counter(), time.thread_time()
        simulated_s, steps = fly()
        spent = time.thread_time() - processor, time.perf_counter() - wall
        speeds.append(Speed(name, simulated_s, *spent, steps))
    return min(speeds, key=lambda speed: speed.processor_s)


def flight_in(scenario: Scenario, sight: VisionSource) -> Callable[[], tuple[float, int]]:
    """Build a world and a follower in it, and return what flies it."""
    world, clock = World(scenario), SimulatedClock()
    if sight is VisionSource.PIXELS:
        _ = world.ground, world.sky, world.scenery_batch
    settings = load_settings(base=base_settings(scenario))
    ends, extras = MemoryTransport.pair(), FlightOptions(vision=sight)
    flight = SimulatedFlight(world, settings, "px4", clock, ends, extras)

    def fly() -> tuple[float, int]:
        with closing(flight):
            fly_lockstep(flight, clock, lambda: None)
        return clock.now(), len(flight.log.controls)

    return fly


def random_flights() -> tuple[float, int]:
    """Fly the first random flights of seed 0."""
    steps = sum(fly_random((0, number)).steps for number in range(RANDOM_FLIGHTS))
    return steps * STEP_S, steps


def main() -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    parser = command_line.parser(__doc__)
    parser.add_argument("scenario", nargs="?", default="winding")
    parser.add_argument("seconds", nargs="?", type=command_line.positive, default=SECONDS)
    options = parser.parse_args()
    changes = (f"duration_s={options.seconds}",)
    scenario = load_scenario(find_scenario(options.scenario), changes)
    camera = scenario.camera
    heads = ("simulated", "processor", "real time", "by wall", "steps/s")
    print(
        f"{'one thread':32}"
        + "".join(f"{head:>{w}}" for head, w in zip(heads, (9, 9, 11, 10, 10), strict=True))
    )
    pixels = f"{camera.width}x{camera.height} pixels at {camera.rate_hz:g} Hz"
    print(timed(pixels, lambda: flight_in(scenario, VisionSource.PIXELS)).line())
    print(timed("truth + noise, no pixels", lambda: flight_in(scenario, VisionSource.TRUTH)).line())
    print(timed("random flights, no pixels", lambda: random_flights).line())


if __name__ == "__main__":
    command_line.run(main)
