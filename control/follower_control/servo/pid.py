"""A PID loop that takes measured intervals and is told how much of its output was cut."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

_SHORTEST_S = 1e-3


@dataclass(frozen=True, slots=True)
class PidSettings:
    """Gains and time constants of one loop.

    Attributes:
        kp: proportional gain, output per unit of error.
        ki: integral gain, output per unit of error and second.
        kd: derivative gain, output per unit of the measurement's rate.
        derivative_filter_s: time constant of the derivative's first-order low-pass.
        tracking_s: time constant with which the integral gives way to an output cut short.
        cut_tolerance: a cut up to this size counts as none, so that an envelope that smooths noise
            does not stop the integral.
        bumpless_s: time constant with which the step at the start is faded out.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    derivative_filter_s: float = 0.2
    tracking_s: float = 1.0
    cut_tolerance: float = 0.0
    bumpless_s: float = 0.5

    def __post_init__(self) -> None:
        if not all(0 <= gain < math.inf for gain in (self.kp, self.ki, self.kd)):
            raise ValueError(f"gains are finite and not negative, not {self}")
        if not 0 <= self.cut_tolerance < math.inf:
            raise ValueError(f"cut_tolerance is finite and not negative, not {self.cut_tolerance}")
        times = (self.derivative_filter_s, self.tracking_s, self.bumpless_s)
        if not all(_SHORTEST_S <= time < math.inf for time in times):
            raise ValueError(f"time constants are finite and at least {_SHORTEST_S} s, not {self}")


class Pid:
    """output = kp error + ki integral of error - kd rate of the measurement + feed-forward.

    The derivative acts on the measurement, so that a new wish gives no kick. What was allowed of
    the last output is told with the next update: the integral does not grow further beyond it
    (conditional integration) and gives way towards it, but never past zero (back-calculation),
    after Åström and Hägglund, "Advanced PID Control", ch. 3.5.

    Args:
        settings: gains and time constants.
        lowest: smallest output.
        highest: largest output.

    Raises:
        ValueError: the limits leave no room.
    """

    def __init__(
        self, settings: PidSettings, lowest: float = -math.inf, highest: float = math.inf
    ) -> None:
        _check_room(lowest, highest)
        self._settings = settings
        self._lowest, self._highest = lowest, highest
        self._error = 0.0
        self.start()

    def start(self, present_output: float | None = None) -> None:
        """Begin anew; the first output will be `present_output`, if that is given.

        The difference to what the loop would have said by itself fades out over `bumpless_s`.
        """
        self._integral = 0.0
        self._rate = 0.0
        self._measurement: float | None = None
        self._bump = 0.0
        self._excess = 0.0
        self._error = 0.0
        self._gain = 1.0
        self._present = present_output

    def change(
        self,
        settings: PidSettings,
        lowest: float = -math.inf,
        highest: float = math.inf,
        unit: float = 1.0,
        gain: float = 1.0,
    ) -> None:
        """Go on by other gains or limits, without a step in the output.

        The integral is kept as its contribution to the output and the derivative's filter by what
        it has seen, so that neither jumps when its gain does. What the other gains would make of
        the present error is taken out, and fades in over `bumpless_s`.

        Args:
            settings: gains and time constants from now on.
            lowest: smallest output, in the new unit.
            highest: largest output, likewise.
            unit: the output's new unit in the old one: the integral is rescaled by it.
            gain: the factor on the gains that the next update will be given.

        Raises:
            ValueError: the limits leave no room.
        """
        _check_room(lowest, highest)
        before, self._settings = self._settings, settings
        self._lowest, self._highest = lowest, highest
        self._integral /= unit
        self._excess /= unit
        self._present = None if self._present is None else self._present / unit
        gained = (gain * settings.kp - self._gain * before.kp / unit) * self._error
        damped = (gain * settings.kd - self._gain * before.kd / unit) * self._rate
        self._bump = self._bump / unit - (gained - damped)

    @property
    def integral(self) -> float:
        """What the integral contributes to the output."""
        return self._integral

    def update(
        self,
        error: float,
        measurement: float,
        interval_s: float,
        feed_forward: float = 0.0,
        cut: float = 0.0,
        gain: float = 1.0,
    ) -> float:
        """Return the output for now.

        Args:
            error: wanted minus measured.
            measurement: what the derivative acts on.
            interval_s: time since the last update.
            feed_forward: added to the output.
            cut: how much of the last output was not carried out: last output minus allowed.
            gain: factor on all three gains; what is integrated already stays as it is.

        Raises:
            ValueError: the interval is not positive, or a number is not finite.
        """
        numbers = (error, measurement, interval_s, feed_forward, cut, gain)
        if not all(map(math.isfinite, numbers)):
            raise ValueError("a PID loop needs finite numbers")
        if interval_s <= 0:
            raise ValueError(f"a PID loop needs a positive interval, not {interval_s}")
        self._error, self._gain = error, gain
        self._differentiate(measurement, interval_s)
        self._integrate(gain * error, interval_s, cut + self._excess)
        kp, kd = gain * self._settings.kp, gain * self._settings.kd
        wanted = kp * error + self._integral - kd * self._rate
        return self._limited(self._faded(wanted + feed_forward, interval_s))

    def _differentiate(self, measurement: float, interval_s: float) -> None:
        if self._measurement is not None:
            slope = (measurement - self._measurement) / interval_s
            share = interval_s / (interval_s + self._settings.derivative_filter_s)
            self._rate += share * (slope - self._rate)
        self._measurement = measurement

    def _integrate(self, error: float, interval_s: float, cut: float) -> None:
        if abs(cut) <= self._settings.cut_tolerance:
            cut = 0.0
        if error * cut <= 0:
            self._integral += self._settings.ki * error * interval_s
        if self._integral * cut > 0:
            give = abs(cut) * min(1.0, interval_s / self._settings.tracking_s)
            self._integral -= math.copysign(min(give, abs(self._integral)), cut)

    def _faded(self, output: float, interval_s: float) -> float:
        if self._present is not None:
            self._bump, self._present = self._present - output, None
        else:
            self._bump *= math.exp(-interval_s / self._settings.bumpless_s)
        return output + self._bump

    def _limited(self, output: float) -> float:
        limited = min(max(output, self._lowest), self._highest)
        self._excess = output - limited
        return limited


def _check_room(lowest: float, highest: float) -> None:
    if not lowest < highest:
        raise ValueError(f"an output needs room, not {lowest} to {highest}")
