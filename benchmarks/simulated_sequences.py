"""Simulated flights as annotated sequences, to fit or measure trackers on.

    python benchmarks/simulated_sequences.py OUT [--first 300] [--count 14]

Flies runs of the standard campaign with `--vision truth+noise`, so that no tracker decides what
is seen, and writes OUT/NAME/img and OUT/NAME/groundtruth.txt: up to 450 frames about the first
time that the target is hidden, or the flight's last ones. A target of which less than 0.3 is to be
seen counts as absent ("0,0,0,0"). The first 300 runs are left to measure on.
"""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
from rich.progress import track as progress

from follower.simulation.campaign.config import RunSpec, load_campaign, planned
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import VisionSource
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.track import Track

MOST_FRAMES, BEFORE_HIDING = 450, 200
ABSENT, LEAST_SEEN, WELL_SEEN = "0,0,0,0", 0.3, 0.95


@dataclass
class Annotator:
    """Keeps the frames of a flight with the target's true box; a `FlightVideo`."""

    flight: SimulatedFlight | None = None
    kept: deque[tuple[Image, str, bool]] = field(default_factory=lambda: deque(maxlen=MOST_FRAMES))
    was_hidden: bool = False

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Take a frame, if the target has been chosen."""
        del tracks, lines
        full = self.was_hidden and len(self.kept) == MOST_FRAMES
        if full or self.flight is None or self.flight.chosen_s is None:
            return
        seen = self.flight.true_target(frame.captured_s)
        present = seen.box is not None and seen.visible_share * seen.in_frame_share > LEAST_SEEN
        text = ABSENT
        if present and seen.box is not None:
            text = ",".join(f"{value:.2f}" for value in seen.box.xywh)
        good = present and min(seen.visible_share, seen.in_frame_share) > WELL_SEEN
        self.kept.append((frame.image.copy(), text, good))
        if not present and not self.was_hidden:
            self.was_hidden = True
            self.kept = deque(list(self.kept)[-BEFORE_HIDING:], maxlen=MOST_FRAMES)

    def write(self, folder: Path) -> None:
        """Write the sequence; it begins where the target is well in view."""
        frames = list(self.kept)
        while frames and not frames[0][2]:
            del frames[0]
        (folder / "img").mkdir(parents=True, exist_ok=True)
        for number, (image, _, _) in enumerate(frames, 1):
            path = str(folder / "img" / f"{number:06d}.jpg")
            cv2.imwrite(path, image, [cv2.IMWRITE_JPEG_QUALITY, 95])
        (folder / "groundtruth.txt").write_text("".join(f"{text}\n" for _, text, _ in frames))


def fly(spec: RunSpec, out: Path) -> None:
    """Fly one run, and write its sequence."""
    options = replace(spec.options(), vision=VisionSource.TRUTH)
    scenario, settings = options.resolve()
    world, clock, ends = World(scenario, spec.seed), SimulatedClock(), MemoryTransport.pair()
    annotator = Annotator()
    extras = FlightOptions(vision=VisionSource.TRUTH, video=annotator)
    flight = SimulatedFlight(world, settings, spec.autopilot, clock, ends, extras)
    annotator.flight = flight
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    annotator.write(out / f"{scenario.name}-{spec.number}")


def main() -> None:
    """Fly and write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="takes a folder for each flight")
    parser.add_argument("--first", type=int, default=300, help="number of the first run")
    parser.add_argument("--count", type=int, default=14, help="how many runs")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    specs = planned(load_campaign("standard"))[options.first :][: options.count]
    for spec in progress(specs, "flights"):
        fly(spec, options.out)


if __name__ == "__main__":
    main()
