"""One follow loop as a linear system."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import control
import numpy as np

from follower_control.tuning.margins import Margins, bandwidth_rad_s, frequencies, margins_of
from follower_control.tuning.rational import PADE_ORDER, Array, ComplexArray, Rational


@dataclass(frozen=True, slots=True)
class AxisLoop:
    """u = Kt yt - Ko yo + Kv v, with v = P u and yo = G v: what is steered, by what is seen.

    The target's own motion w moves the same quantity the other way: yt = G w; the error that
    matters is e = yt - yo.

    Attributes:
        name: of the axis.
        unit: of y.
        plant: P, from the loop's output u to the vehicle's motion v in the same unit.
        geometry: G, from that motion to the quantity that is held.
        from_own: Ko, from what our own motion did to the quantity, to u; added up.
        from_target: Kt, from what the target's motion did to it, to u.
        from_motion: Kv, from our own motion as telemetry tells it, to u; added up.
        from_reference: from what is wanted of the quantity, to u.
        noise: standard deviation of one sighting, in the quantity's unit.
        noise_interval_s: between two sightings.
        motion_unit: of v, as it is flown.
        motion_scale: from u to that.
    """

    name: str
    unit: str
    plant: Rational
    geometry: Rational
    from_own: tuple[Rational, ...]
    from_target: Rational
    from_motion: tuple[Rational, ...]
    from_reference: Rational
    noise: float
    noise_interval_s: float
    motion_unit: str
    motion_scale: float

    def open_loop(self, frequency_rad_s: Array) -> ComplexArray:
        """Return L = P (Ko G - Kv), cut open at the loop's output."""
        back = _sum_at(self.from_own, frequency_rad_s) * self.geometry.at(frequency_rad_s)
        back -= _sum_at(self.from_motion, frequency_rad_s)
        return np.asarray(self.plant.at(frequency_rad_s) * back, np.complex128)

    def sensitivity(self, frequency_rad_s: Array) -> ComplexArray:
        """Return 1 / (1 + L)."""
        return np.asarray(1 / (1 + self.open_loop(frequency_rad_s)), np.complex128)

    def following(self, frequency_rad_s: Array) -> ComplexArray:
        """Return from what is wanted to what is: the quantity's response to its reference."""
        ahead = self.from_reference * self.plant * self.geometry
        return np.asarray(
            ahead.at(frequency_rad_s) * self.sensitivity(frequency_rad_s), np.complex128
        )

    def disturbance(self, frequency_rad_s: Array) -> ComplexArray:
        """Return from the target's motion w to the error e."""
        answer = (self.plant * self.geometry * self.from_target).at(frequency_rad_s)
        share = 1 - answer * self.sensitivity(frequency_rad_s)
        return np.asarray(self.geometry.at(frequency_rad_s) * share, np.complex128)

    def jitter(self) -> float:
        """Return how much sighting noise makes the commanded motion shake, RMS, as flown."""
        frequency = frequencies(0.01, np.pi / self.noise_interval_s)[::4]
        gain = np.abs(self.from_target.at(frequency) * self.sensitivity(frequency)) ** 2
        density = self.noise**2 * self.noise_interval_s
        power = float(np.trapezoid(gain, frequency)) * density / np.pi
        return self.motion_scale * math.sqrt(power)

    def margins(self) -> Margins:
        """Return what the loop bears; they mean nothing if it is unstable already."""
        grid = frequencies()
        return margins_of(grid, self.open_loop(grid))

    def bandwidth_rad_s(self) -> float:
        """Return up to which frequency the quantity follows its reference, -3 dB."""
        grid = frequencies()
        return bandwidth_rad_s(grid, self.following(grid))

    def system(self, pade_order: int = PADE_ORDER) -> control.StateSpace:
        """Return the open loop for python-control, cut open as in `open_loop`."""
        motion = self.plant.system(pade_order)
        own = control.series(self.geometry.system(), _parallel(self.from_own, pade_order))
        if self.from_motion:
            own = own - _parallel(self.from_motion, pade_order)
        return control.series(motion, own)

    def is_stable(self) -> bool:
        """Whether the closed loop settles, by its poles."""
        poles = control.feedback(self.system(), 1).poles()
        return bool(np.all(poles.real < 1e-6))

    def step_response(self, until_s: float) -> tuple[Array, Array]:
        """Return times and the quantity after what is wanted of it jumped by one."""
        ahead = (self.from_reference * self.plant).system()
        closed = control.feedback(1, self.system())
        return _step(control.series(closed, ahead, self.geometry.system()), until_s)

    def disturbance_response(self, until_s: float) -> tuple[Array, Array]:
        """Return times and the error after the target began to move steadily, w = 1."""
        geometry, closed = self.geometry.system(), control.feedback(1, self.system())
        answer = control.series(self.from_target.system(), closed, self.plant.system(), geometry)
        return _step(control.series(geometry, 1 - answer), until_s)


def _sum_at(systems: Sequence[Rational], frequency_rad_s: Array) -> ComplexArray:
    total = np.zeros(len(frequency_rad_s), np.complex128)
    for one in systems:
        total += one.at(frequency_rad_s)
    return total


def _parallel(systems: Sequence[Rational], pade_order: int) -> control.StateSpace:
    total = systems[0].system(pade_order)
    for one in systems[1:]:
        total = control.parallel(total, one.system(pade_order))
    return total


def _step(system: control.StateSpace, until_s: float) -> tuple[Array, Array]:
    times = np.linspace(0.0, until_s, 801)
    response = control.forced_response(system, times, np.ones_like(times))
    return np.asarray(response.time, np.float64), np.asarray(response.outputs, np.float64)
