"""What weather, light and lens look like, and what the follower makes of them.

    python benchmarks/weather.py sheet docs/pictures/weather.jpg
    python benchmarks/weather.py curves docs/pictures/weather-curves.svg [SEEDS [PROCESSES]]

`curves` flies the first 16 s of the scenario `demo`, before the hall, at 15 frames a second. Good
are the seconds, of those in which nothing hides the chosen target, in which the box overlaps the
true one by half in half of the frames. They depend on one another: the intervals are too narrow.
"""

from __future__ import annotations

from bisect import bisect
from contextlib import closing
from dataclasses import replace
from functools import cache, partial
from multiprocessing import get_context
from typing import NamedTuple

import command_line
import cv2
import numpy as np
from matplotlib.figure import Figure

from follower.flight.supervision.autonomy import AutonomyPhase
from follower.settings.settings import find_scenario, load_settings
from follower.simulation.campaign.summary import share_text, wilson
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.camera import SimCamera
from follower_sim.chaser import Chaser
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.images.frame import Image
from follower_vision.trackers.track import TrackState

UNTIL_S = 16.0


class Effect(NamedTuple):
    """A key of the scenario, its strengths, the factor to its unit, a turn for pictures, rad/s."""

    key: str
    strengths: tuple[float, ...]
    unit: float = 1.0
    turn: float = 0.0

    def scenario(self, strength: float, *changes: str) -> Scenario:
        """Return the scenario `demo` with the effect."""
        effect = f"{self.key}={self.unit * strength:g}"
        return load_scenario(find_scenario("demo"), (*changes, effect))


EFFECTS = {
    "low light [stops]": Effect("camera.low_light.stops", (5, 8, 10)),
    "rain [mm/h]": Effect("weather.rain_mm_h", (25, 75, 200)),
    "fog [1/m]": Effect("weather.fog_per_m", (0.05, 0.15, 0.3)),
    "lens dirt [share]": Effect("camera.lens_dirt", (0.1, 0.3, 0.6)),
    "rolling shutter [us/row]": Effect("camera.row_time_s", (20, 40, 65), 1e-6, 4.0),
    "exposure [ms]": Effect("camera.exposure_s", (10, 20, 33), 1e-3, 1.5),
}


def sheet(path: str) -> None:
    """Draw a row an effect, its strengths from left to right, at 14 s."""
    rows = [[shown(e, s, f"{name} {s:g}") for s in e.strengths] for name, e in EFFECTS.items()]
    cv2.imwrite(path, np.vstack([*map(np.hstack, rows)]), [cv2.IMWRITE_JPEG_QUALITY, 80])


@cache
def drawn() -> dict[str, object]:
    """Return what takes long to draw and is the same in all pictures."""
    world = World(load_scenario(find_scenario("demo")))
    return {name: getattr(world, name) for name in ("ground", "sky", "scenery_batch")}


def shown(effect: Effect, strength: float, text: str) -> Image:
    """Return a small picture from behind the car, with its name."""
    world = World(effect.scenario(strength, "camera.exposure_s=0.002", "camera.blur_steps=16"))
    vars(world).update(drawn())  # weather changes none of it, and it takes seconds
    body = replace(Chaser(world)(14.0), rates_rad_s=(0.0, 0.0, effect.turn))
    camera = SimCamera(world, lambda _: body)
    while (delivery := camera.capture()) is None or delivery.exposure.captured_s < 14.0:
        camera.next_capture_s = 14.0
    small = cv2.resize(delivery.frame.image, (320, 240), interpolation=cv2.INTER_AREA)[60:]
    cv2.rectangle(small, (0, 160), (8 * len(text), 180), (0, 0, 0), cv2.FILLED)
    cv2.putText(small, text, (4, 174), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1)
    return np.asarray(small, np.uint8)


def point_out(flight: SimulatedFlight, truth: GroundTruth, clock: SimulatedClock) -> None:
    """Draw a box round the target once the vehicle is airborne, however it is seen."""
    if flight.phase is AutonomyPhase.AIRBORNE and flight.chosen_s is None:
        box = truth.seen(clock.now(), flight.vehicle.state_at(clock.now())).box
        if box is not None:
            sides = box.left / 640, box.top / 480, box.right / 640, box.bottom / 480
            flight.requests.select_rectangle(*sides, "operator")


def fly(job: tuple[Effect, float, int]) -> tuple[int, int]:
    """Fly so many seeds; return the good seconds and all in which nothing hides the target."""
    effect, strength, seeds = job
    cv2.setNumThreads(1)
    scenario = effect.scenario(strength, f"duration_s={UNTIL_S}", "camera.rate_hz=15")
    settings = load_settings(base=base_settings(scenario))
    seconds: dict[tuple[int, int], list[bool]] = {}
    for seed in range(1, seeds + 1):
        clock, ends, world = SimulatedClock(), MemoryTransport.pair(), World(scenario, seed)
        with closing(SimulatedFlight(world, settings, "px4", clock, ends)) as flight:
            flight.operate()
            fly_lockstep(flight, clock, partial(point_out, flight, GroundTruth(world), clock))
        overlaps = (frame.overlap for frame in flight.ground_truth.tracked)
        times = [step.time_s for step in flight.truth]
        for record in flight.log.tracks:
            tracked = record.track is not None and record.track.state is TrackState.TRACKING
            right = tracked and next(overlaps) >= 0.5
            step = flight.truth[min(bisect(times, record.captured_s), len(times) - 1)]
            counts = (flight.chosen_s or UNTIL_S) <= record.captured_s < UNTIL_S
            if counts and step.visible_share >= 0.5:
                seconds.setdefault((seed, int(record.captured_s)), []).append(right)
    return sum(bool(np.mean(one) >= 0.5) for one in seconds.values()), len(seconds)


def curves(path: str, seeds: int, processes: int) -> None:
    """Fly, print and draw the share of good seconds over each effect's strength."""
    plain = EFFECTS["fog [1/m]"], 0.0
    groups = [plain, *((effect, s) for effect in EFFECTS.values() for s in effect.strengths)]
    shares = {}
    with get_context("spawn").Pool(processes) as pool:
        flown = pool.imap(fly, [(*group, seeds) for group in groups])
        for group, share in zip(groups, flown, strict=True):
            shares[group] = share
            print(f"{group[0].key} {group[1]:g}: {share_text(*share)}", flush=True)
    figure = Figure(figsize=(8, 4.2), layout="constrained")
    panels = figure.subplots(2, 3, sharey=True).ravel().tolist()
    for axes, (name, effect) in zip(panels, EFFECTS.items(), strict=True):
        points = [shares[plain], *(shares[effect, s] for s in effect.strengths)]
        middle = np.array([good / count for good, count in points])
        bars = np.abs(middle - np.array([wilson(*one) for one in points]).T)
        axes.errorbar((0, *effect.strengths), middle, bars, marker="o", capsize=3)
        axes.set(xlabel=name, ylim=(-0.03, 1.03))
    figure.savefig(path)


def main() -> None:
    """Draw what the command line asks for."""
    parser = command_line.parser(__doc__)
    parser.add_argument("what", choices=("sheet", "curves"))
    parser.add_argument("path", help="the picture to write")
    parser.add_argument("seeds", nargs="?", type=command_line.count, default=2)
    parser.add_argument("processes", nargs="?", type=command_line.count, default=2)
    options = parser.parse_args()
    if options.what == "sheet":
        sheet(options.path)
    else:
        curves(options.path, options.seeds, options.processes)


if __name__ == "__main__":
    command_line.run(main)
