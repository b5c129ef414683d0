"""What Fusion chose from in simulated flights: for `follower train fusion --choices`.

    python benchmarks/fusion_flights.py OUT [--first 300] [--count 24] [--jobs 2] [--set KEY=VALUE]

Flies runs of the standard campaign with pixels. Fusion is put back on its target some time after
a loss, and writes OUT/NUMBER.npz: each candidate's features and its overlap with the truth,
control's predictions among them. The truth is the part of the target that was chosen, as a person's
shirt: held against the whole person, every right box would be a wrong one. A target of which less
than 0.3 is to be seen counts as absent. The first 300 runs are left to measure on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import command_line
from rich.progress import track as progress

from follower.simulation.campaign.config import RunSpec, load_campaign, planned
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower.training.fusion.driving import Teacher
from follower.workers import LocalEngine
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.fusion import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import Track

LEAST_SEEN = 0.3
_CHOSEN = "start"
_GONE_S = 6.0
"""Control, too, follows something else by then: what it foretells teaches the wrong thing."""


@dataclass(frozen=True, slots=True)
class Part:
    """The part of a target that was chosen, in sizes of the whole.

    Attributes:
        right: of its middle from the whole's.
        down: the same downwards.
        width: of it.
        height: of it.
    """

    right: float = 0.0
    down: float = 0.0
    width: float = 1.0
    height: float = 1.0

    @classmethod
    def chosen(cls, box: Box, whole: Box) -> Part:
        """Return the part of a whole that a box is."""
        right, down = (box.cx - whole.cx) / whole.width, (box.cy - whole.cy) / whole.height
        return cls(right, down, box.width / whole.width, box.height / whole.height)

    def of(self, whole: Box) -> Box:
        """Return where the part is, by where the whole is."""
        cx, cy = whole.cx + self.right * whole.width, whole.cy + self.down * whole.height
        return Box(cx, cy, self.width * whole.width, self.height * whole.height)


class Lesson:
    """Tells a flight's Fusion the truth after each step; a `FlightVideo`."""

    def __init__(self) -> None:
        self.teacher: Teacher | None = None
        self.flight: SimulatedFlight | None = None
        self._part = Part()
        self._there_s = -math.inf

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Take a frame's answer."""
        del lines
        if self.teacher is not None and self.flight is not None and tracks:
            seen = self.flight.ground_truth.of_frame(frame.captured_s)
            there = seen.visible_share * seen.in_frame_share > LEAST_SEEN
            if tracks[0].produced_by == _CHOSEN and seen.box is not None:
                self._part = Part.chosen(tracks[0].box, seen.box)
            truth = self._part.of(seen.box) if there and seen.box is not None else None
            self._there_s = self._there_s if truth is None else frame.captured_s
            if frame.captured_s - self._there_s < _GONE_S:
                self.teacher.correct(tracks[0], truth)


def fly(spec: RunSpec, out: Path) -> None:
    """Fly one run, and write its choices.

    Raises:
        SettingsError: the scenario does not fly with Fusion.
    """
    options = spec.options()
    scenario, settings = options.resolve()
    world, clock, ends = World(scenario, spec.seed), SimulatedClock(), MemoryTransport.pair()
    lesson = Lesson()
    extras = FlightOptions(vision=options.vision, video=lesson)
    flight = SimulatedFlight(world, settings, spec.autopilot, clock, ends, extras)
    if not isinstance(flight.tracker, FusionTracker):
        raise SettingsError(f"{scenario.name} does not fly with Fusion: name a detector in it")
    lesson.flight, lesson.teacher = flight, Teacher(flight.tracker)
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    lesson.teacher.examples().save(out / f"{spec.number}.npz")


def main() -> None:
    """Fly and write what was asked for."""
    parser = command_line.parser(__doc__)
    parser.add_argument("out", type=Path, help="takes a file for each flight")
    parser.add_argument("--first", type=int, default=300, help="number of the first run")
    parser.add_argument("--count", type=command_line.count, default=24, help="how many runs")
    parser.add_argument("--jobs", type=command_line.count, default=2, help="processes")
    parser.add_argument("--set", action="append", default=[], help="a setting of the follower")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    runs = planned(load_campaign("standard"))[options.first :][: options.count]
    specs = [replace(run, overrides=(*run.overrides, *options.set)) for run in runs]
    with closing(LocalEngine(options.jobs)) as engine:
        flown = engine.run(partial(fly, out=options.out), specs)
        for done in progress(flown, "flights", total=len(specs)):
            _ = done.result


if __name__ == "__main__":
    command_line.run(main)
