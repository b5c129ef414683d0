"""How fast the simulated camera renders the scenario `winding`, all imperfections on, on one core.

Run: python benchmarks/render.py [SCENARIO.yaml]
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from follower_sim.camera import SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.world.world import World

WINDING = Path(__file__).parent.parent / "configs" / "scenarios" / "winding.yaml"
FRAMES = 600
BEHIND_M, ABOVE_M = 12.6, 8.0


class Chaser:
    """Flies behind the followed target where it was half a second ago, and yaws with it."""

    def __init__(self, world: World) -> None:
        self._world = world

    def __call__(self, time_s: float) -> BodyState:
        """Return the state at a time."""
        pose = self._world.target_pose(self._world.scenario.followed, time_s)
        before, after = (self._heading(time_s + dt) for dt in (-0.05, 0.05))
        yaw = self._heading(time_s)
        north, east, down = pose.position_m
        position = (
            north - BEHIND_M * math.cos(yaw),
            east - BEHIND_M * math.sin(yaw),
            down - ABOVE_M,
        )
        yaw_rate = math.remainder(after - before, math.tau) / 0.1
        roll, pitch = 0.05 * math.sin(2.1 * time_s), -0.08 + 0.05 * math.sin(1.4 * time_s)
        rates = (0.105 * math.cos(2.1 * time_s), 0.07 * math.cos(1.4 * time_s), yaw_rate)
        return BodyState(time_s, position, pose.velocity_m_s, (roll, pitch, yaw), rates)

    def _heading(self, time_s: float) -> float:
        return self._world.target_pose(self._world.scenario.followed, time_s - 0.5).heading_rad


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
