"""Is a hidden car found again, and is another one taken for it? With a detector and without.

    python benchmarks/hidden_car.py --seeds 50

Flies the scenario `demo` on a simulated clock, each seed with the scenario's own settings (Fusion
with the embedded detector) and without a detector. A seed changes the
scenery, the wind, the camera's noise and timing. Each flight takes the time of some 1200 rendered
frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import command_line
import cv2
import numpy as np

from follower.settings.settings import find_scenario, load_settings
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.scoring.identity_score import TAKEN_S, IdentityScore
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

SOON_S = 1.0
"""So quickly a target that comes into sight again is to be found."""
WAYS = {"with the detector": (), "without": ("detector=null",)}


@dataclass(frozen=True, slots=True)
class Result:
    """What came of one flight."""

    seed: int
    identity: IdentityScore

    @property
    def found(self) -> bool:
        """Whether the target was hidden, and found again each time."""
        return self.identity.disappearances > 0 and not self.identity.never_found

    @property
    def found_soon(self) -> bool:
        """Whether that took no more than a second."""
        return self.found and (self.identity.slowest_found_s or 0.0) <= SOON_S

    @property
    def taken(self) -> bool:
        """Whether another target was taken for it."""
        return (self.identity.mistaken_s or 0.0) > TAKEN_S


def main() -> None:
    """Fly all, print a line for each flight and a table at the end."""
    options = _options()
    cv2.setNumThreads(1)
    scenario = load_scenario(find_scenario(options.scenario))
    print(f"{'seed':>5} {'way':22} {'hidden':>7} {'found after':>12} {'on another':>11}")
    results: dict[str, list[Result]] = {name: [] for name in WAYS}
    for seed in range(options.first, options.first + options.seeds):
        for name, changes in WAYS.items():
            if name not in options.ways:
                continue
            result = Result(seed, fly(scenario, seed, (*options.set, *changes)))
            results[name].append(result)
            print(_line(name, result), flush=True)
    for name, flown in results.items():
        if flown:
            print(_summary(name, flown))


def fly(scenario: Scenario, seed: int, overrides: Sequence[str]) -> IdentityScore:
    """Fly once in lockstep and return what became of the target's identity."""
    clock = SimulatedClock()
    settings = load_settings(base=base_settings(scenario), overrides=overrides)
    ends = MemoryTransport.pair()
    flight = SimulatedFlight(World(scenario, seed), settings, "px4", clock, ends)
    fly_lockstep(flight, clock, lambda: None)
    return flight.ground_truth.identity


def _options() -> argparse.Namespace:
    parser = command_line.parser(__doc__)
    parser.add_argument("--seeds", type=command_line.count, default=50, help="how many")
    parser.add_argument("--first", type=int, default=1, help="the first one")
    parser.add_argument("--scenario", default="demo")
    parser.add_argument("--ways", nargs="*", default=list(WAYS), choices=list(WAYS))
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    return parser.parse_args()


def _line(name: str, result: Result) -> str:
    identity = result.identity
    after = "never" if identity.never_found else _seconds(identity.slowest_found_s)
    hidden, other = _seconds(identity.longest_hidden_s), _seconds(identity.mistaken_s)
    return f"{result.seed:5} {name:22} {hidden:>7} {after:>12} {other:>11}"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} s"


def _summary(name: str, flown: Sequence[Result]) -> str:
    count = len(flown)
    waits = [one.identity.slowest_found_s for one in flown if one.found]
    known = [wait for wait in waits if wait is not None]
    median = f"{np.median(known):.2f} s" if known else "-"
    return (
        f"{name}: {count} flights; found again {_share([one.found for one in flown])}, within "
        f"{SOON_S:g} s {_share([one.found_soon for one in flown])}, median {median}; "
        f"took the other car {_share([one.taken for one in flown])}"
    )


def _share(flags: Sequence[bool]) -> str:
    return f"{sum(flags)} ({100 * sum(flags) / len(flags):.0f} %)"


if __name__ == "__main__":
    command_line.run(main)
