"""A camera that flies behind the target, as no autopilot would: for films to measure on."""

import math

from follower_sim.kinematics import BodyState
from follower_sim.world.world import World

_BEHIND_M, _ABOVE_M, _DELAY_S = 12.6, 8.0, 0.5


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
            north - _BEHIND_M * math.cos(yaw),
            east - _BEHIND_M * math.sin(yaw),
            down - _ABOVE_M,
        )
        yaw_rate = math.remainder(after - before, math.tau) / 0.1
        roll, pitch = 0.05 * math.sin(2.1 * time_s), -0.08 + 0.05 * math.sin(1.4 * time_s)
        rates = (0.105 * math.cos(2.1 * time_s), 0.07 * math.cos(1.4 * time_s), yaw_rate)
        return BodyState(time_s, position, pose.velocity_m_s, (roll, pitch, yaw), rates)

    def _heading(self, time_s: float) -> float:
        number = self._world.scenario.followed
        return self._world.target_pose(number, time_s - _DELAY_S).heading_rad
