"""The estimator's Kalman filter as a linear system, after it has settled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_are

from follower_control.tuning.rational import Rational


@dataclass(frozen=True, slots=True)
class SteadyFilter:
    """A constant-velocity filter with constant gains, as if it ran without pauses.

    Its poles are those of the sampled filter at its frame rate; a target that moves steadily is
    followed without error, as the sampled one does.

    Attributes:
        rate_gain_per_s2: k2 of the denominator s² + k1 s + k2.
        gain_per_s: k1.
        noise: standard deviation of what it is fed.
        interval_s: between two frames.
    """

    rate_gain_per_s2: float
    gain_per_s: float
    noise: float
    interval_s: float

    @classmethod
    def of(cls, acceleration: float, noise: float, interval_s: float) -> SteadyFilter:
        """Settle the filter.

        Args:
            acceleration: root of the spectral density of the white acceleration, per sqrt(Hz).
            noise: standard deviation of one measurement.
            interval_s: between two frames.

        Raises:
            ValueError: one of them is not above 0.
        """
        if min(acceleration, noise, interval_s) <= 0:
            raise ValueError("a filter has acceleration, noise and interval above 0")
        t, q = interval_s, acceleration**2
        move = np.array([[1.0, t], [0.0, 1.0]])
        drive = q * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        seen = np.array([[1.0, 0.0]])
        before = solve_discrete_are(move.T, seen.T, drive, np.array([[noise**2]]))
        gain = before @ seen.T / (before[0, 0] + noise**2)
        poles = np.log(np.linalg.eigvals((np.eye(2) - gain @ seen) @ move).astype(complex)) / t
        return cls(float(np.prod(poles).real), float(-np.sum(poles).real), noise, t)

    @property
    def natural_frequency_rad_s(self) -> float:
        """How fast it follows."""
        return math.sqrt(self.rate_gain_per_s2)

    def value(self, age_s: float) -> Rational:
        """Return from the measured value, `age_s` old, to the one predicted to now."""
        k1, k2 = self.gain_per_s, self.rate_gain_per_s2
        return Rational((k1 + age_s * k2, k2), (1.0, k1, k2), age_s)

    @property
    def missed(self) -> Rational:
        """From the measured value to what the filter does not follow of it: one less `value`."""
        return Rational((1.0, 0.0, 0.0), (1.0, self.gain_per_s, self.rate_gain_per_s2))

    def rate(self, age_s: float) -> Rational:
        """Return from the measured value, `age_s` old, to the rate."""
        k1, k2 = self.gain_per_s, self.rate_gain_per_s2
        return Rational((k2, 0.0), (1.0, k1, k2), age_s)
