"""Linear systems with a delay: num(s) / den(s) * exp(-delay * s)."""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

PADE_ORDER = 4
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
        """Return the system with more delay."""
        return Rational(self.numerator, self.denominator, self.delay_s + by_s)

    def at(self, frequency_rad_s: Array) -> ComplexArray:
        """Return the frequency response, with the delay as it is and not as Padé has it."""
        s = 1j * frequency_rad_s
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.delay_s * s), np.complex128)

    def system(self, pade_order: int = PADE_ORDER) -> control.StateSpace:
        """Return it for python-control, the delay by Padé."""
        own = control.ss(control.tf(list(self.numerator), list(self.denominator)))
        if self.delay_s == 0:
            return own
        return control.series(control.ss(control.tf(*control.pade(self.delay_s, pade_order))), own)


ONE = Rational((1.0,))


def integrator(gain: float = 1.0) -> Rational:
    """Return gain / s."""
    return Rational((gain,), (1.0, 0.0))


def low_pass(time_constant_s: float) -> Rational:
    """Return 1 / (T s + 1)."""
    return Rational((1.0,), (time_constant_s, 1.0)) if time_constant_s > 0 else ONE


def _product(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(x) for x in np.polymul(a, b))


def _sum(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(x) for x in np.polyadd(a, b))
