"""Of the bodies that never move, those that may come between a camera and what it sees."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from follower_sim.ball import Ball
from follower_sim.kinematics import Triple
from follower_sim.solid import Solid
from follower_vision.camera import Vector

_SPARE_M = 4.0
"""So far the camera or the target may move before all bodies are looked through again."""

Standing = tuple[Ball, Solid]


class Corridor:
    """Finds the bodies about a line of sight, which are few, without a look at all of them.

    Args:
        standing: the bodies.
    """

    def __init__(self, standing: Sequence[Solid]) -> None:
        self._standing: list[Standing] = [(ball_of(solid), solid) for solid in standing]
        self._centres = np.array([ball.centre_m for ball, _ in self._standing]).reshape(-1, 3)
        self._radii = np.array([ball.radius_m for ball, _ in self._standing])
        self._ends: tuple[Triple, Triple] | None = None
        self._radius_m = -math.inf
        self._about: list[Standing] = []

    def about(self, eye_m: Triple, target: Ball) -> list[Standing]:
        """Return, in their order, all bodies that can hide any of a ball, and few others."""
        if not self._still_holds(eye_m, target):
            self._ends, self._radius_m = (eye_m, target.centre_m), target.radius_m
            # What hides has its middle no farther from the line than both radii, or the eye in it.
            near = self._distances_m(eye_m, target) < 2 * self._radii + target.radius_m + _SPARE_M
            self._about = [self._standing[i] for i in np.flatnonzero(near)]
        return self._about

    def _still_holds(self, eye_m: Triple, target: Ball) -> bool:
        if self._ends is None or target.radius_m > self._radius_m:
            return False
        eye, end = self._ends
        return math.dist(eye, eye_m) < _SPARE_M and math.dist(end, target.centre_m) < _SPARE_M

    def _distances_m(self, eye_m: Triple, target: Ball) -> Vector:
        """Return how far each body's middle, (N,), is from the line between eye and target."""
        line = np.subtract(target.centre_m, eye_m)
        away = self._centres - eye_m
        along = np.clip(away @ line / max(float(line @ line), 1e-9), 0.0, 1.0)
        return np.asarray(np.linalg.norm(away - along[:, None] * line, axis=1))


def ball_of(solid: Solid) -> Ball:
    """Return the ball that holds a body."""
    north, east, down = solid.centre.tolist()
    return Ball((north, east, down), solid.radius_m)


def hides(one: Ball, target: Ball, eye_m: Triple) -> bool:
    """Whether what one ball holds can hide any of what another one holds."""
    # Plain floats are fastest for so few.
    north, east, down = (a - b for a, b in zip(one.centre_m, eye_m, strict=True))
    to_north, to_east, to_down = (a - b for a, b in zip(target.centre_m, eye_m, strict=True))
    away2 = north * north + east * east + down * down
    range2 = to_north * to_north + to_east * to_east + to_down * to_down
    if away2 >= range2:
        return False
    along = (north * to_north + east * to_east + down * to_down) / math.sqrt(range2)
    near = away2 - along * along < (one.radius_m + target.radius_m) ** 2
    return near and along > -one.radius_m
