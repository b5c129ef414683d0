"""How fast the simulated camera renders the scenario `winding`, all imperfections on, on one core.

    python benchmarks/render.py [SCENARIO.yaml [KEY=VALUE ...]]

With keys of the scenario, such as `weather.rain_mm_h=75`, frames with each of them alone are drawn
in turn with plain ones, and the median ratio of the processor's times is printed.
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
FRAMES, PAIRS = 600, 60


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


def ratio(path: Path, change: str) -> float:
    """Return how many times as long a frame takes with one key changed, drawn in turn."""
    worlds = [World(load_scenario(path, overrides)) for overrides in ((), (change,))]
    cameras = [SimCamera(world, Chaser(world)) for world in worlds]
    times = np.linspace(0.2, 0.9, PAIRS) * worlds[0].scenario.duration_s
    pairs = [[drawn_s(camera, time_s) for camera in cameras] for time_s in times.tolist()]
    return float(np.median([changed / plain for plain, changed in pairs]))


def drawn_s(camera: SimCamera, time_s: float) -> float:
    """Return the processor's seconds for the frame of a time."""
    camera.next_capture_s, began = time_s, time.thread_time()
    delivery = camera.capture()
    while delivery is None:
        delivery = camera.capture()
    _ = delivery.frame
    return time.thread_time() - began


def main() -> None:
    """Print the medians and percentiles."""
    cv2.setNumThreads(1)
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else WINDING
    if len(sys.argv) > 2:
        for change in sys.argv[2:]:
            print(f"{path.stem}, {change}: {ratio(path, change):.2f} times a plain frame")
        return
    for name, seconds in zip(("wall", "processor"), frame_times(path), strict=True):
        median, p95 = (1e3 * float(np.quantile(seconds, q)) for q in (0.5, 0.95))
        print(
            f"{path.stem}, {name} time: median {median:.2f} ms a frame, p95 {p95:.2f} ms, "
            f"{1 / float(np.mean(seconds)):.0f} frames a second"
        )


if __name__ == "__main__":
    main()
