"""What a loop bears before it oscillates, read off its exact frequency response."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from follower_control.tuning.rational import Array, ComplexArray


def frequencies(lowest_rad_s: float = 0.01, highest_rad_s: float = 100.0) -> Array:
    """Return a grid that is dense enough for the margins below."""
    count = round(250 * math.log10(highest_rad_s / lowest_rad_s)) + 1
    return np.geomspace(lowest_rad_s, highest_rad_s, count)


@dataclass(frozen=True, slots=True)
class Margins:
    """How far a loop is from the edge of stability; infinite where it never comes near.

    Attributes:
        gain: by what factor the gain may rise.
        gain_at_rad_s: at which frequency it would then oscillate; NaN if it never would.
        phase_rad: how much phase may be lost at the worst crossover.
        crossover_rad_s: the highest frequency at which the loop's gain is one; 0 if it never is.
        delay_s: how much more delay the loop bears: the smallest of phase margin over frequency.
        max_sensitivity: Ms, the largest factor by which the loop makes a disturbance worse; its
            inverse is the smallest distance of the Nyquist curve from -1.
        sensitive_at_rad_s: at which frequency.
    """

    gain: float
    gain_at_rad_s: float
    phase_rad: float
    crossover_rad_s: float
    delay_s: float
    max_sensitivity: float
    sensitive_at_rad_s: float


def margins_of(frequency_rad_s: Array, loop: ComplexArray) -> Margins:
    """Return the margins of a stable closed loop with unity feedback.

    Args:
        frequency_rad_s: (N,), rising and dense; see `frequencies`.
        loop: (N,), L(jw).
    """
    gain, gain_at = _gain_margin(frequency_rad_s, loop)
    phase, crossover, delay = _phase_margins(frequency_rad_s, loop)
    sensitivity = 1.0 / np.maximum(np.abs(1.0 + loop), 1e-12)
    worst = int(np.argmax(sensitivity))
    return Margins(
        gain,
        gain_at,
        phase,
        crossover,
        delay,
        float(sensitivity[worst]),
        float(frequency_rad_s[worst]),
    )


def bandwidth_rad_s(frequency_rad_s: Array, closed: ComplexArray) -> float:
    """Return up to where a closed loop follows: the first -3 dB; infinite if that never comes.

    Against the response to what changes slowest on the grid, which is what it should be 1 at.
    """
    level = np.abs(closed) / max(float(np.abs(closed[0])), 1e-12)
    below = np.flatnonzero(level < math.sqrt(0.5))
    if not len(below):
        return math.inf
    return _between(frequency_rad_s, level - math.sqrt(0.5), int(below[0]) - 1)


def _gain_margin(frequency: Array, loop: ComplexArray) -> tuple[float, float]:
    """Return the smallest factor above one that brings the curve onto -1, and where."""
    found = []
    for i in np.flatnonzero(np.diff(np.sign(loop.imag)) != 0):
        share = loop.imag[i] / (loop.imag[i] - loop.imag[i + 1])
        real = float(loop.real[i] + share * (loop.real[i + 1] - loop.real[i]))
        if -1.0 <= real < 0.0:
            found.append((-1.0 / real, _between(frequency, loop.imag, int(i))))
    return min(found, default=(math.inf, math.nan))


def _phase_margins(frequency: Array, loop: ComplexArray) -> tuple[float, float, float]:
    """Return the smallest phase margin, the highest crossover, the smallest delay margin."""
    level = np.log(np.maximum(np.abs(loop), 1e-300))
    phase, crossover, delay = math.inf, 0.0, math.inf
    angles = np.unwrap(np.angle(loop))
    for i in np.flatnonzero(np.diff(np.sign(level)) != 0):
        at = _between(frequency, level, int(i))
        angle = float(np.interp(at, frequency, angles))
        ahead = (angle + math.pi) % (2 * math.pi)
        delay = min(delay, ahead / at)
        phase = min(phase, ahead if ahead <= math.pi else 2 * math.pi - ahead)
        crossover = max(crossover, at)
    return phase, crossover, delay


def _between(frequency: Array, values: Array, i: int) -> float:
    """Return where values cross zero between two points of the grid, on a logarithmic axis."""
    if i < 0:
        return float(frequency[0])
    a, b = float(values[i]), float(values[i + 1])
    share = a / (a - b) if a != b else 0.0
    low, high = math.log(frequency[i]), math.log(frequency[i + 1])
    return math.exp(low + share * (high - low))
