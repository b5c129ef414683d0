"""The prediction of the target's box: one Kalman filter over place, size and their rates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box

Vector = npt.NDArray[np.float64]

_VELOCITY_TIME_S = 0.7
"""After so long without an observation a velocity is believed by a third."""
_START_SPEED = 3.0
"""Standard deviation of the first velocity in target sizes a second."""
_START_SPREAD = 0.03
_MOST_RATE = 1.0
"""The log of the size changes by no more a second."""


@dataclass(frozen=True, slots=True)
class FilterNoise:
    """Noise of the filter, estimated from data by `follower train fusion`.

    Places are in target sizes (square root of the area), sizes in the log of the side.

    Attributes:
        manoeuvre: spectral density of the place's acceleration, sizes / s^1.5.
        growth: the same of the log sides' second derivative, 1 / s^1.5.
        place: standard deviation of an observed centre, by its source.
        size: standard deviation of the log of an observed side, by its source.
    """

    manoeuvre: float
    growth: float
    place: dict[str, float]
    size: dict[str, float]


class BoxFilter:
    """A Kalman filter with four independent axes: centre x, y, log width, log height.

    Each axis has a value and a rate that fades while nothing is observed. Noise of the places is in
    target sizes, so that the filter is the same for near and far targets.

    Args:
        noise: estimated from data.
        box: at the start, in pixels.
    """

    def __init__(self, noise: FilterNoise, box: Box) -> None:
        self._noise = noise
        self.place_at(box)

    def place_at(self, box: Box) -> None:
        """Begin anew at a box, in pixels."""
        self._value = axes_of(box)
        self._rate = np.zeros(4)
        unit = self._unit()
        self._vv = (_START_SPREAD * unit) ** 2
        self._vr = np.zeros(4)
        self._rr = (np.array([_START_SPEED, _START_SPEED, 0.3, 0.3]) * unit) ** 2

    @property
    def box(self) -> Box:
        """Where the target is believed to be, in pixels."""
        cx, cy, wide, tall = self._value.tolist()
        return Box(cx, cy, math.exp(wide), math.exp(tall))

    @property
    def spread(self) -> float:
        """Standard deviation of the centre in target sizes."""
        scale = math.exp(0.5 * (self._value[2] + self._value[3]))
        return math.sqrt(max(self._vv[0], self._vv[1])) / scale

    @property
    def deviations(self) -> Vector:
        """Standard deviations of centre x, y (pixels) and log width and height, shape (4,)."""
        return np.sqrt(self._vv)

    @property
    def speed(self) -> float:
        """Of the centre, in target sizes a second."""
        scale = math.exp(0.5 * (self._value[2] + self._value[3]))
        return math.hypot(self._rate[0], self._rate[1]) / scale

    def predict(self, interval_s: float) -> None:
        """Go on by a time in seconds."""
        fade = math.exp(-interval_s / _VELOCITY_TIME_S)
        reach = _VELOCITY_TIME_S * (1 - fade)
        self._value = self._value + reach * self._rate
        self._rate = fade * self._rate
        noise = self._noise
        density = np.array([noise.manoeuvre, noise.manoeuvre, noise.growth, noise.growth])
        power = (density * self._unit()) ** 2 * interval_s
        self._vv = self._vv + 2 * reach * self._vr + reach**2 * self._rr + power * interval_s**2 / 3
        self._vr = fade * (self._vr + reach * self._rr) + power * interval_s / 2
        self._rr = fade**2 * self._rr + power

    def observe(self, box: Box, source: str, probability: float) -> None:
        """Take in an observed box, in pixels, in proportion to how probable it is, above 0."""
        noise = self._noise
        place, size = noise.place[source], noise.size[source]
        spread = np.array([place, place, size, size]) * self._unit()
        self._update(axes_of(box), (spread / probability) ** 2, np.ones(4))

    def expect(self, cx: float, cy: float, spread_px: float) -> None:
        """Take in where the centre should be by other knowledge, with a standard deviation."""
        value = np.array([cx, cy, self._value[2], self._value[3]])
        used = np.array([1.0, 1.0, 0.0, 0.0])
        self._update(value, np.full(4, spread_px**2), used)

    def keep_within(self, width: int, height: int) -> None:
        """Keep the centre on the image, whose sides are given in pixels, and sizes sensible."""
        for axis, side in ((0, width), (1, height)):
            if not 0 <= self._value[axis] <= side:
                self._value[axis] = min(max(self._value[axis], 0.0), float(side))
                self._rate[axis] = 0.0
            size = self._value[2 + axis]
            self._value[2 + axis] = min(max(size, math.log(2.0)), math.log(2.0 * side))

    def _update(self, seen: Vector, variance: Vector, used: Vector) -> None:
        total = self._vv + variance
        gain, rate_gain = used * self._vv / total, used * self._vr / total
        error = seen - self._value
        self._value = self._value + gain * error
        self._rate = self._rate + rate_gain * error
        self._rate[2:] = np.clip(self._rate[2:], -_MOST_RATE, _MOST_RATE)
        self._rr = self._rr - rate_gain * self._vr
        self._vr = (1 - gain) * self._vr
        self._vv = (1 - gain) * self._vv

    def _unit(self) -> Vector:
        """What one target size, or one unit of log size, is on each axis."""
        scale = math.exp(0.5 * (self._value[2] + self._value[3]))
        return np.array([scale, scale, 1.0, 1.0])


def axes_of(box: Box) -> Vector:
    """Return what the filter's axes are of a box in pixels: centre x, y, log width and height."""
    return np.array([box.cx, box.cy, math.log(box.width), math.log(box.height)])
