"""Wind over time: a mean and gusts, the same for the same seed."""

import math

import numpy as np

from follower_control.common.small_matrix import length
from follower_sim.kinematics import Triple
from follower_sim.scenario.scenario import WindSettings

_PERIODS_S = (11.3, 6.1, 3.7, 2.3, 1.3)


class Wind:
    """A sum of sinusoids about the mean: smooth, unbounded in time, in closed form.

    Their periods (1 to 11 s) and falling amplitudes follow the shape of a Dryden spectrum at low
    height closely enough to shake a hovering multirotor as gusts do.
    """

    def __init__(self, settings: WindSettings, rng: np.random.Generator) -> None:
        towards = math.radians(settings.from_deg) + math.pi
        self._mean = (
            settings.mean_m_s * math.cos(towards),
            settings.mean_m_s * math.sin(towards),
            0.0,
        )
        weights = np.sqrt(np.array(_PERIODS_S))
        weights *= math.sqrt(2) / length(weights)
        scale = np.array([1.0, 1.0, 1 / 3])[:, None] * settings.gust_m_s
        self._amplitudes = scale * weights
        self._phases = rng.uniform(0, 2 * math.pi, (3, len(_PERIODS_S)))
        self._rates = 2 * math.pi / np.array(_PERIODS_S)

    def velocity_m_s(self, time_s: float) -> Triple:
        """Return the air's velocity (north, east, down) at a time of the scenario."""
        gusts = (self._amplitudes * np.sin(self._rates * time_s + self._phases)).sum(axis=1)
        (north, east, down), (n, e, d) = self._mean, gusts.tolist()
        return north + n, east + e, down + d
