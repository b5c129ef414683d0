"""Smooth random courses of one quantity over the frames of a scene."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Course = npt.NDArray[np.float64]


def wander(rng: np.random.Generator, frames: int, step: float, memory: float) -> Course:
    """Return (frames,) a course from zero whose speed is an Ornstein-Uhlenbeck process.

    Args:
        rng: the source of chance.
        frames: how many.
        step: standard deviation of the change from frame to frame.
        memory: 0 to 1, how much of the speed is kept from frame to frame.
    """
    speed = np.empty(frames)
    speed[0] = 0.0
    last = rng.normal() * step
    kicks = rng.normal(size=frames) * step * np.sqrt(1.0 - memory**2)
    for frame in range(1, frames):
        last = memory * last + kicks[frame]
        speed[frame] = last
    return np.cumsum(speed)


def hover(rng: np.random.Generator, frames: int, spread: float, memory: float) -> Course:
    """Return (frames,) a course about zero with a standard deviation, that does not run away."""
    course = np.empty(frames)
    last = rng.normal() * spread
    kicks = rng.normal(size=frames) * spread * np.sqrt(1.0 - memory**2)
    for frame in range(frames):
        course[frame] = last
        last = memory * last + kicks[frame]
    return course


def folded(course: Course, least: float, most: float) -> Course:
    """Reflect a course at two limits."""
    span = max(most - least, 1e-9)
    phase = np.mod(course - least, 2 * span)
    return least + np.where(phase > span, 2 * span - phase, phase)
