"""Linear systems with a delay: num(s) / den(s) * exp(-delay * s)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import control
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_PADE_ORDER = 4
"""Of the delay's Padé approximation, where a system of finite order is needed."""


@dataclass(frozen=True, slots=True)
class Rational:
    """One linear system.

    Attributes:
        numerator: coefficients, the highest power of s first.
        denominator: likewise.
        delay_s: not negative.

    Raises:
        ValueError: the denominator is zero, or the delay negative or not finite.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        if not any(self.denominator):
            raise ValueError("a system's denominator is not zero")
        if not 0 <= self.delay_s < np.inf:
            raise ValueError(f"a delay is finite and not negative, not {self.delay_s}")

    def __mul__(self, other: Rational) -> Rational:
        return Rational(
            _product(self.numerator, other.numerator),
            _product(self.denominator, other.denominator),
            self.delay_s + other.delay_s,
        )

    def __add__(self, other: Rational) -> Rational:
        """Return both side by side; their delays are the same."""
        if self.delay_s != other.delay_s:
            raise ValueError("only systems with the same delay add up to one")
        if self.denominator == other.denominator:
            numerator = _sum(self.numerator, other.numerator)
            return Rational(numerator, self.denominator, self.delay_s)
        return Rational(
            _sum(
                _product(self.numerator, other.denominator),
                _product(other.numerator, self.denominator),
            ),
            _product(self.denominator, other.denominator),
            self.delay_s,
        )

    def scaled(self, factor: float) -> Rational:
        """Return the system times a number."""
        return Rational(tuple(factor * x for x in self.numerator), self.denominator, self.delay_s)

    def delayed(self, by_s: float) -> Rational:
        """Return the system with so many seconds more delay."""
        return Rational(self.numerator, self.denominator, self.delay_s + by_s)

    def at(self, frequency_rad_s: Array) -> ComplexArray:
        """Return the frequency response, (N,), with the delay as it is and not as Padé has it."""
        s = 1j * frequency_rad_s
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.delay_s * s), np.complex128)

    def system(self) -> control.StateSpace:
        """Return it for python-control, the delay by Padé."""
        own = control.ss(control.tf(list(self.numerator), list(self.denominator)))
        if self.delay_s == 0:
            return own
        return control.series(control.ss(control.tf(*control.pade(self.delay_s, _PADE_ORDER))), own)


ONE = Rational((1.0,))


def integrator(gain: float = 1.0) -> Rational:
    """Return gain / s."""
    return Rational((gain,), (1.0, 0.0))


def _product(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(x) for x in np.polymul(a, b))


def _sum(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(x) for x in np.polyadd(a, b))


def frequencies(lowest_rad_s: float = 0.001, highest_rad_s: float = 100.0) -> Array:
    """Return a grid, (N,) rad/s, that is dense enough for the margins below."""
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
    """

    gain: float
    gain_at_rad_s: float
    phase_rad: float
    crossover_rad_s: float
    delay_s: float
    max_sensitivity: float


def margins_of(frequency_rad_s: Array, loop: ComplexArray) -> Margins:
    """Return the margins of a stable closed loop with unity feedback.

    Args:
        frequency_rad_s: (N,), rising and dense; see `frequencies`.
        loop: (N,), L(jw).
    """
    response = control.FrequencyResponseData(loop[None, None], frequency_rad_s, smooth=True)
    gains, phases_deg, _, at, crossovers, _ = control.stability_margins(response, returnall=True)
    rising = [(float(g), float(w)) for g, w in zip(gains, at, strict=True) if g >= 1]
    gain, gain_at = min(rising, default=(math.inf, math.nan))
    ahead = np.radians(phases_deg) % (2 * math.pi)
    return Margins(
        gain,
        gain_at,
        float(np.minimum(ahead, 2 * math.pi - ahead).min(initial=math.inf)),
        float(np.max(crossovers, initial=0.0)),
        float((ahead / crossovers).min(initial=math.inf)),
        max_sensitivity_of(loop),
    )


def max_sensitivity_of(loop: ComplexArray) -> float:
    """Return Ms of a loop's frequency response, (N,)."""
    return float(np.max(1.0 / np.maximum(np.abs(1.0 + loop), 1e-12)))


def bandwidth_rad_s(frequency_rad_s: Array, closed: ComplexArray) -> float:
    """Return up to where a closed loop follows: the first -3 dB; infinite if that never comes.

    Against the response to what changes slowest on the grid, which is what it should be 1 at.
    """
    level = np.abs(closed) / max(float(np.abs(closed[0])), 1e-12)
    below = np.flatnonzero(level < math.sqrt(0.5))
    if not len(below):
        return math.inf
    return _between(frequency_rad_s, level - math.sqrt(0.5), int(below[0]) - 1)


def _between(frequency: Array, values: Array, i: int) -> float:
    """Return where values cross zero between two points of the grid, on a logarithmic axis."""
    if i < 0:
        return float(frequency[0])
    a, b = float(values[i]), float(values[i + 1])
    share = a / (a - b) if a != b else 0.0
    low, high = math.log(frequency[i]), math.log(frequency[i + 1])
    return math.exp(low + share * (high - low))
