"""How a vehicle answers a velocity or yaw rate that is asked for: a few numbers."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfiltic

from follower_control.common.strict_config import check_ranges
from follower_control.tuning.rational import Array, Rational

STEP_S = 0.01
"""Models are stepped at this interval between the samples."""


@dataclass(frozen=True, slots=True)
class ResponseModel:
    """Order one: K / (T s + 1). Order two: K (b s + 1) / (T² s² + 2 ζ T s + 1). Both with a delay.

    Attributes:
        gain: steady output per input.
        dead_time_s: from the sending of a setpoint until the vehicle begins to answer.
        time_constant_s: T; of order two, one over the natural frequency.
        damping: ζ; None makes the order one.
        lead_s: b; a slow last part of the answer shows as a lead that the slow pole does not
            cancel.
        rate_limit: the output changes no faster than this, per second; None if that was not seen.
            Left out of the linear model.
    """

    gain: float
    dead_time_s: float
    time_constant_s: float
    damping: float | None = None
    lead_s: float = 0.0
    rate_limit: float | None = None

    def __post_init__(self) -> None:
        check_ranges(
            self,
            gain=(0.01, 100),
            dead_time_s=(0, 3600),
            time_constant_s=(1e-4, 3600),
            damping=(0.01, 100),
            lead_s=(0, 3600),
            rate_limit=(1e-3, 1e4),
        )

    @property
    def order(self) -> int:
        """One or two."""
        return 1 if self.damping is None else 2

    @property
    def denominator(self) -> tuple[float, ...]:
        """Coefficients, the highest power of s first."""
        t = self.time_constant_s
        return (t, 1.0) if self.damping is None else (t * t, 2 * self.damping * t, 1.0)

    @property
    def linear(self) -> Rational:
        """The model without its rate limit."""
        numerator = (self.gain * self.lead_s, self.gain) if self.lead_s else (self.gain,)
        return Rational(numerator, self.denominator, self.dead_time_s)


@dataclass(frozen=True, slots=True)
class VehicleModel:
    """How a vehicle answers on each axis; velocities in its heading frame, SI units and radians.

    Attributes:
        forward, right, down: velocities.
        yaw_rate: the turning of the nose.
    """

    forward: ResponseModel
    right: ResponseModel
    down: ResponseModel
    yaw_rate: ResponseModel


class TooLittleError(ValueError):
    """A recording does not show what was asked of it; the message says why and what would do."""


@dataclass(frozen=True, slots=True, eq=False)
class ResponseData:
    """One unbroken stretch.

    Attributes:
        name: of the recording.
        input_s: (M,) times at which the input changed, rising; it stays in between.
        inputs: (M,) what was asked for from then on.
        output_s: (N,) times of the samples, rising.
        outputs: (N,) what was measured.
    """

    name: str
    input_s: Array
    inputs: Array
    output_s: Array
    outputs: Array

    def __post_init__(self) -> None:
        parts = (self.input_s, self.inputs, self.output_s, self.outputs)
        if not all(np.all(np.isfinite(part)) for part in parts):
            raise TooLittleError(f"{self.name}: there are numbers in it that are not finite")
        if len(self.input_s) != len(self.inputs) or len(self.output_s) != len(self.outputs):
            raise ValueError(f"{self.name}: as many times as values are needed")
        for times in (self.input_s, self.output_s):
            if np.any(np.diff(times) <= 0):
                raise TooLittleError(f"{self.name}: its times do not rise")

    @property
    def length_s(self) -> float:
        """From the first sample to the last, seconds."""
        return float(self.output_s[-1] - self.output_s[0]) if len(self.output_s) else 0.0

    def predicted(self, model: ResponseModel) -> Array:
        """Return what the model says for each sample, (N,), at rest before the first input.

        Free running: it is given the inputs and never a measured output.
        """
        start, end = float(self.output_s[0]), float(self.output_s[-1])
        begin = min(start, float(self.input_s[0]))
        count = max(2, int(np.ceil((end - begin) / STEP_S)) + 2)
        edges = np.asarray(begin + STEP_S * np.arange(count), np.float64)
        seen = np.asarray(edges - model.dead_time_s, np.float64)
        asked = _held_mean(self.input_s, self.inputs, seen)
        first = float(self.inputs[0])
        answer = _simulated(model, asked, first)
        return np.asarray(np.interp(self.output_s, edges, answer), np.float64)


def _held_mean(times_s: Array, values: Array, edges_s: Array) -> Array:
    """Return the mean input of the interval that ends at each edge, shape (N,)."""
    area = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(times_s))])
    total = np.interp(edges_s, times_s, area)
    total += np.where(edges_s < times_s[0], (edges_s - times_s[0]) * values[0], 0.0)
    total += np.where(edges_s > times_s[-1], (edges_s - times_s[-1]) * values[-1], 0.0)
    means = np.diff(total) / np.diff(edges_s)
    return np.concatenate([[values[0]], means])


def _simulated(model: ResponseModel, asked: Array, first: float) -> Array:
    if model.rate_limit is not None:
        return _limited(model, asked, first)
    linear = model.linear
    discrete = cont2discrete(
        (np.atleast_1d(linear.numerator), np.atleast_1d(linear.denominator)), STEP_S, "zoh"
    )
    b, a = np.ravel(discrete[0]), np.ravel(discrete[1])
    steady = model.gain * first
    state = lfiltic(b, a, np.full(len(a), steady), np.full(len(b), first))
    # The mean of an interval acts until its end, where the sample is: one step earlier than lfilter
    # would have it.
    shifted = np.concatenate([asked[1:], asked[-1:]])
    answer, _ = lfilter(b, a, shifted, zi=state)
    return np.asarray(answer, np.float64)


def _limited(model: ResponseModel, asked: Array, first: float) -> Array:
    """Step the model with its output's rate held within the limit."""
    limit, t = model.rate_limit or np.inf, model.time_constant_s
    a2, a1, _ = (0.0, *model.denominator) if model.order == 1 else model.denominator
    gain, lead = model.gain, model.lead_s
    value, rate = gain * first, 0.0
    answer = np.empty(len(asked))
    before = first
    for i, u in enumerate(asked.tolist()):
        wanted = gain * (u + lead * (u - before) / STEP_S)
        before = u
        if a2 == 0:
            goal = (wanted - value) * (1 - np.exp(-STEP_S / t)) / STEP_S
        else:
            goal = (rate + STEP_S * (wanted - value) / a2) / (1 + STEP_S * a1 / a2)
        rate = min(max(goal, -limit), limit)
        value += rate * STEP_S
        answer[i] = value
    return answer
