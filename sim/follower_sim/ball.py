"""A ball that holds a body: to tell cheaply what cannot matter."""

from __future__ import annotations

from dataclasses import dataclass

from follower_sim.kinematics import Triple


@dataclass(frozen=True, slots=True)
class Ball:
    """A ball in the world: its middle (north, east, down) and its radius."""

    centre_m: Triple
    radius_m: float
