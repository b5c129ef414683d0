"""How fast, how far and how exactly a signal followed a step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from follower_sim.scoring.recorded_step import RecordedStep, Series

_STEADY_S = 2.0
_AGREEMENT = 0.15
_REPEATABILITY = 0.02
_ROW_S = 0.02
_SEND_S = 0.05
_PEAK_SIGMAS = 4.0


@dataclass(frozen=True, slots=True)
class SteppedSignal:
    """A signal that was asked to step.

    Attributes:
        name: "forward", "right", "down" (m/s) or "yaw rate" (deg/s); in a world frame, north and
            east stand for the first two.
        values: shape (N,).
        target: what was asked for.
        error: RMS of what is read before the step, where 0 was asked for; level axes share theirs.
    """

    name: str
    values: Series
    target: float
    error: float


def asked_velocity_m_s(step: RecordedStep) -> Series:
    """Return the velocity in the frame of the setpoints, world or heading: shape (3, N)."""
    in_world = step.sent[1].frame in (1, 7)
    return step.velocity_m_s if in_world else step.heading_velocity_m_s


def stepped_signals(step: RecordedStep) -> list[SteppedSignal]:
    """Return the signals that the second setpoint asked to step."""
    asked = step.sent[1]
    signals = [*asked_velocity_m_s(step), np.degrees(step.yaw_rate_rad_s)]
    targets = [*asked.velocity_m_s, math.degrees(asked.yaw_rate_rad_s)]
    errors = [_rms(signal[step.time_s <= asked.time_s]) for signal in signals]
    errors[:2] = [math.hypot(*errors[:2]) / math.sqrt(2.0)] * 2
    names = ("forward", "right", "down", "yaw rate")
    rows = zip(names, signals, targets, errors, strict=True)
    return [SteppedSignal(*row) for row in rows if row[2] != 0]


def tilt_rad(step: RecordedStep) -> Series:
    """Return the angle between the body's down axis and gravity, shape (N,)."""
    roll, pitch, _ = step.attitude_rad
    return np.asarray(np.arccos(np.cos(roll) * np.cos(pitch)), np.float64)


def max_tilt_deg(step: RecordedStep) -> float:
    """Return the largest angle between the body's down axis and gravity."""
    return math.degrees(tilt_rad(step).max())


def _rms(values: Series) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, slots=True)
class StepMetrics:
    """A step from 0 (before) to 1 (asked for), whatever the signal's unit.

    Attributes:
        t63_s, t90_s: from the first send until that share was first reached, infinite if never.
        overshoot: the peak beyond 1, as a share; negative if 1 was not reached.
        steady: the mean of the last two seconds.
        noise: RMS of what is read before the step, where it should be 0, and at least 2 %: that
            is how much the steady states of equal recorded steps differ.
        peak_noise: how far noise alone lifts the highest of several hundred readings: 3 to 4
            times their RMS.
        t63_noise_s, t90_noise_s: how far those times move if the level is off by the noise, at
            least one row and one period of the stream.
    """

    t63_s: float
    t90_s: float
    overshoot: float
    steady: float
    noise: float
    peak_noise: float
    t63_noise_s: float
    t90_noise_s: float

    def disagreements(self, other: StepMetrics, noise: bool = True) -> list[str]:
        """Return where `other` is farther off than 15 % and this one's own noise explain.

        The two are independent of each other, so that their squares add. Without noise only the
        15 % count.
        """
        return [
            f"{name}: {theirs:.3f} for {ours:.3f}, allowed {allowed:.3f}"
            for name, ours, theirs, error in self._comparison(other)
            if not abs(theirs - ours) <= (allowed := _allowed(ours, error if noise else 0.0))
        ]

    def _comparison(self, other: StepMetrics) -> list[tuple[str, float, float, float]]:
        """Return rows of (name, this one's value, the other's, this one's noise)."""
        rows = [
            ("overshoot", self.overshoot, other.overshoot, self.peak_noise),
            ("steady", self.steady, other.steady, self.noise),
            ("t63", self.t63_s, other.t63_s, self.t63_noise_s),
        ]
        if math.isfinite(self.t90_s):
            rows.append(("t90", self.t90_s, other.t90_s, self.t90_noise_s))
        return rows


def _allowed(value: float, noise: float) -> float:
    return math.hypot(_AGREEMENT * value, noise)


def rise(step: RecordedStep, signal: SteppedSignal) -> StepMetrics:
    """Return the metrics of a recording's step up, its second setpoint."""
    _, up, down = (sent.time_s for sent in step.sent[:3])
    return _measured(step.time_s, signal.values / signal.target, (up, down), _error(signal))


def fall(step: RecordedStep, signal: SteppedSignal) -> StepMetrics:
    """Return the metrics of a recording's step back to zero, its third setpoint."""
    level = 1.0 - signal.values / signal.target
    return _measured(step.time_s, level, (step.sent[2].time_s, math.inf), _error(signal))


def _error(signal: SteppedSignal) -> float:
    return signal.error / abs(signal.target)


def _measured(
    time_s: Series, level: Series, span: tuple[float, float], error: float
) -> StepMetrics:
    start, end = span
    noise = max(error, _REPEATABILITY)
    inside = (time_s > start) & (time_s <= end)
    times, levels = time_s[inside] - start, level[inside]
    steady = float(levels[times >= times[-1] - _STEADY_S].mean())
    t63, t90 = crossing(times, levels, 0.63), crossing(times, levels, 0.9)
    return StepMetrics(
        t63,
        t90,
        float(levels.max()) - 1.0,
        steady,
        noise,
        max(_PEAK_SIGMAS * error, _REPEATABILITY),
        _spread(times, levels, 0.63, noise),
        _spread(times, levels, 0.9, noise),
    )


def crossing(time_s: Series, level: Series, share: float) -> float:
    """Return when the level first reaches a share, between samples; infinite if it never does."""
    above = np.flatnonzero(level >= share)
    if not len(above):
        return math.inf
    i = int(above[0])
    if i == 0:
        return float(time_s[0])
    part = (share - level[i - 1]) / (level[i] - level[i - 1])
    return float(time_s[i - 1] + part * (time_s[i] - time_s[i - 1]))


def _spread(time_s: Series, level: Series, share: float, noise: float) -> float:
    """Return how far a crossing moves with the level's noise; infinite if it may never come."""
    early, late = (crossing(time_s, level, share + sign * noise) for sign in (-1, 1))
    middle = crossing(time_s, level, share)
    if math.isinf(late):
        return math.inf
    return max(middle - early, late - middle, _ROW_S + _SEND_S / 2)
