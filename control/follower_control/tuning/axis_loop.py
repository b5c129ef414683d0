"""One follow loop as a linear system."""

import math
from dataclasses import dataclass

import control
import numpy as np

from follower_control.common.strict_config import check_positive, check_ranges
from follower_control.tuning.rational import (
    Array,
    ComplexArray,
    Margins,
    Rational,
    bandwidth_rad_s,
    frequencies,
    margins_of,
)


@dataclass(frozen=True, slots=True)
class AxisLoop:
    """u = Kt yt - Ko yo, with v = P u and yo = G v: what is steered, by what is seen.

    The target's own motion w moves the same quantity the other way: yt = G w; the error that
    matters is e = yt - yo.

    Attributes:
        name: of the axis.
        unit: of y.
        plant: P, from the loop's output u to the vehicle's motion v in the same unit.
        geometry: G, from that motion to the quantity that is held.
        from_own: Ko, from what our own motion did to the quantity, to u; added up.
        from_target: Kt, from what the target's motion did to it, to u.
        from_reference: from what is wanted of the quantity, to u.
        noise: standard deviation of one observation, in the quantity's unit.
        noise_interval_s: between two observations.
        motion_scale: from u to v as it is flown, m/s or rad/s.
        shortfall: S, from by how much the vehicle is slower than what was sent to what is sent on
            top of u; None: nothing is.
    """

    name: str
    unit: str
    plant: Rational
    geometry: Rational
    from_own: tuple[Rational, ...]
    from_target: Rational
    from_reference: Rational
    noise: float
    noise_interval_s: float
    motion_scale: float
    shortfall: Rational | None = None

    def driven(self, frequency_rad_s: Array) -> ComplexArray:
        """Return P / (1 - S (1 - P)), (N,), from u to the vehicle's motion."""
        plant = self.plant.at(frequency_rad_s)
        if self.shortfall is None:
            return plant
        return np.asarray(plant / (1 - self.shortfall.at(frequency_rad_s) * (1 - plant)))

    def _driven_system(self) -> control.StateSpace:
        plant = self.plant.system()
        if self.shortfall is None:
            return plant
        more = control.series(1 - plant, self.shortfall.system())
        return control.series(control.feedback(1, more, sign=1), plant)

    def open_loop(self, frequency_rad_s: Array) -> ComplexArray:
        """Return L = P Ko G, cut open at the loop's output; P as `driven` has it."""
        own = [one.at(frequency_rad_s) for one in self.from_own]
        ahead = self.driven(frequency_rad_s) * self.geometry.at(frequency_rad_s)
        return np.asarray(ahead * np.sum(own, axis=0), np.complex128)

    def sensitivity(self, frequency_rad_s: Array) -> ComplexArray:
        """Return 1 / (1 + L), (N,), at frequencies in rad/s."""
        return np.asarray(1 / (1 + self.open_loop(frequency_rad_s)), np.complex128)

    def following(self, frequency_rad_s: Array) -> ComplexArray:
        """Return from what is wanted to what is: the quantity's response to its reference."""
        ahead = (self.from_reference * self.geometry).at(frequency_rad_s)
        return np.asarray(
            ahead * self.driven(frequency_rad_s) * self.sensitivity(frequency_rad_s), np.complex128
        )

    def jitter(self) -> float:
        """Return how much measurement noise makes the commanded motion shake, RMS, as flown."""
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
        """Return up to which frequency, rad/s, the quantity follows its reference, -3 dB."""
        grid = frequencies()
        return bandwidth_rad_s(grid, self.following(grid))

    def system(self) -> control.StateSpace:
        """Return the open loop for python-control, cut open as in `open_loop`."""
        own = control.parallel(*(one.system() for one in self.from_own))
        return control.series(self._driven_system(), self.geometry.system(), own)

    def is_stable(self) -> bool:
        """Whether the closed loop settles, by its poles."""
        poles = control.feedback(self.system(), 1).poles()
        return bool(np.all(poles.real < 1e-6))

    def step_response(self, until_s: float) -> tuple[Array, Array]:
        """Return times and the quantity after what is wanted of it jumped by one."""
        ahead = control.series(self.from_reference.system(), self._driven_system())
        closed = control.feedback(1, self.system())
        return _step(control.series(closed, ahead, self.geometry.system()), until_s)

    def disturbance_response(self, until_s: float) -> tuple[Array, Array]:
        """Return times and the error after the target began to move steadily, w = 1."""
        geometry, closed = self.geometry.system(), control.feedback(1, self.system())
        answer = control.series(self.from_target.system(), closed, self._driven_system(), geometry)
        return _step(control.series(geometry, 1 - answer), until_s)


def _step(system: control.StateSpace, until_s: float) -> tuple[Array, Array]:
    times = np.linspace(0.0, until_s, 801)
    response = control.forced_response(system, times, np.ones_like(times))
    return np.asarray(response.time, np.float64), np.asarray(response.outputs, np.float64)


@dataclass(frozen=True, slots=True)
class LoopDelays:
    """What passes between a thing and its effect, seconds.

    Attributes:
        camera_s: from a frame's exposure to the first setpoint made from it.
        frame_interval_s: between two frames.
        control_interval_s: between two setpoints.
        position_s: age of the newest position when it is used; no loop depends on it.
        stamp_error_s: how much later than the exposure the frames' stamps are, unknown to the
            follower (its own `camera.latency_s` taken off).
        extra_s: more dead time on the way to the vehicle, unknown to anybody.
    """

    camera_s: float = 0.075
    frame_interval_s: float = 1 / 30
    control_interval_s: float = 0.02
    position_s: float = 0.02
    stamp_error_s: float = 0.0
    extra_s: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(
            self,
            camera_s=(0, 5),
            frame_interval_s=(1e-4, 2),
            control_interval_s=(1e-4, 2),
            position_s=(0, 5),
            stamp_error_s=(-self.camera_s, self.camera_s),
            extra_s=(0, 5),
        )

    @property
    def image_age_s(self) -> float:
        """The average age of what is known of the target, seconds."""
        return self.camera_s + self.frame_interval_s / 2


@dataclass(frozen=True, slots=True)
class Conditions:
    """Where the loops are looked at.

    Attributes:
        delays: of camera, control and telemetry.
        range_m: distance at which the target is steadily followed; another one than the servo's
            `distance_m` by a stick offset.
        elevation_rad: at which the target is seen.
        size_m: the root of its width times its height.
        acceleration_m_s2: how hard the vehicle is steered: the envelope's jerk limit delays a
            harder change by more.
    """

    delays: LoopDelays = LoopDelays()
    range_m: float = 15.0
    elevation_rad: float = -0.3
    size_m: float = 1.8
    acceleration_m_s2: float = 1.0

    def __post_init__(self) -> None:
        check_positive(self, "range_m", "size_m")
        check_ranges(self, elevation_rad=(-1.57, 1.57), acceleration_m_s2=(0, 100))
