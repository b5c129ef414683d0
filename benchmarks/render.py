"""How fast the simulated camera renders the scenario `winding`, all imperfections on, on one core.

Run: python benchmarks/render.py [SCENARIO.yaml]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import cv2
import numpy as np

from follower_sim.camera import SimCamera
from follower_sim.chaser import Chaser
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.world.world import World

WINDING = Path(__file__).parent.parent / "configs" / "scenarios" / "winding.yaml"
FRAMES = 600


def frame_times(path: Path) -> tuple[list[float], list[float]]:
    """Return for frames spread over the scenario the wall and the processor time in seconds."""
    world = World(load_scenario(path))
    camera = SimCamera(world, Chaser(world))
    start_s, step = world.scenario.duration_s / 5, 0.8 * world.scenario.duration_s / FRAMES
    wall, processor = [], []
    for number in range(FRAMES):
        camera.next_capture_s = start_s + number * step
        before, busy = time.perf_counter(), time.thread_time()
        delivery = camera.capture()
        if delivery is not None:
            _ = delivery.frame
        wall.append(time.perf_counter() - before)
        processor.append(time.thread_time() - busy)
    return wall, processor


def main() -> None:
    """Print the medians and percentiles."""
    cv2.setNumThreads(1)
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else WINDING
    for name, seconds in zip(("wall", "processor"), frame_times(path), strict=True):
        median, p95 = (1e3 * float(np.quantile(seconds, q)) for q in (0.5, 0.95))
        print(
            f"{path.stem}, {name} time: median {median:.2f} ms a frame, p95 {p95:.2f} ms, "
            f"{1 / float(np.mean(seconds)):.0f} frames a second"
        )


if __name__ == "__main__":
    main()
