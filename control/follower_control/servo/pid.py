"""A PID loop that takes measured intervals and the saturation of its last output."""

import math
from dataclasses import dataclass

from follower_control.common.strict_config import check_ranges

_SHORTEST_S, _MOST = 1e-3, 1e6


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

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    derivative_filter_s: float = 0.2
    tracking_s: float = 1.0
    cut_tolerance: float = 0.0
    bumpless_s: float = 0.5

    def __post_init__(self) -> None:
        gains = ("kp", "ki", "kd", "cut_tolerance")
        times = ("derivative_filter_s", "tracking_s", "bumpless_s")
        check_ranges(self, **dict.fromkeys(gains, (0.0, _MOST)))
        check_ranges(self, **dict.fromkeys(times, (_SHORTEST_S, _MOST)))


class Pid:
    """output = kp error + ki integral of error - kd rate of the measurement + feed-forward.

    The derivative acts on the measurement, so that a new setpoint gives no kick. How much
    the last output was saturated is given with the next update: the integral does not grow further
    beyond it (conditional integration) and gives way towards it, but never past zero
    (back-calculation), after Åström and Hägglund, "Advanced PID Control", ch. 3.5.

    Args:
        settings: gains and time constants.
        lowest: smallest output.
        highest: largest output.

    Attributes:
        integral: what the integral contributes to the output.
    """

    def __init__(
        self, settings: PidSettings, lowest: float = -math.inf, highest: float = math.inf
    ) -> None:
        self._settings = settings
        self._lowest, self._highest = lowest, highest
        self._error = 0.0
        self.start()

    def start(self, present_output: float | None = None) -> None:
        """Begin anew; the first output will be `present_output`, if that is given.

        The difference to what the loop would have said by itself fades out over `bumpless_s`.
        """
        self.integral = 0.0
        self._rate = 0.0
        self._measurement: float | None = None
        self._step = 0.0
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
        """
        before, self._settings = self._settings, settings
        self._lowest, self._highest = lowest, highest
        self.integral /= unit
        self._excess /= unit
        self._present = None if self._present is None else self._present / unit
        gained = (gain * settings.kp - self._gain * before.kp / unit) * self._error
        damped = (gain * settings.kd - self._gain * before.kd / unit) * self._rate
        self._step = self._step / unit - (gained - damped)

    def update(
        self,
        error: float,
        measurement: float,
        interval_s: float,
        feed_forward: float = 0.0,
        saturation: float = 0.0,
        gain: float = 1.0,
    ) -> float:
        """Return the output for now.

        Args:
            error: wanted minus measured.
            measurement: what the derivative acts on.
            interval_s: time since the last update.
            feed_forward: added to the output.
            saturation: how much of the last output was not carried out: last output minus allowed.
            gain: factor on all three gains; what is integrated already stays as it is.

        Raises:
            ValueError: the interval is not positive, or a number is not finite.
        """
        numbers = (error, measurement, interval_s, feed_forward, saturation, gain)
        if not all(map(math.isfinite, numbers)):
            raise ValueError("a PID loop needs finite numbers")
        if interval_s <= 0:
            raise ValueError(f"a PID loop needs a positive interval, not {interval_s}")
        self._error, self._gain = error, gain
        self._differentiate(measurement, interval_s)
        self._integrate(gain * error, interval_s, saturation + self._excess)
        kp, kd = gain * self._settings.kp, gain * self._settings.kd
        wanted = kp * error + self.integral - kd * self._rate
        return self._limited(self._faded(wanted + feed_forward, interval_s))

    def _differentiate(self, measurement: float, interval_s: float) -> None:
        if self._measurement is not None:
            slope = (measurement - self._measurement) / interval_s
            share = interval_s / (interval_s + self._settings.derivative_filter_s)
            self._rate += share * (slope - self._rate)
        self._measurement = measurement

    def _integrate(self, error: float, interval_s: float, saturation: float) -> None:
        if abs(saturation) <= self._settings.cut_tolerance:
            saturation = 0.0
        if error * saturation <= 0:
            self.integral += self._settings.ki * error * interval_s
        if self.integral * saturation > 0:
            give = abs(saturation) * min(1.0, interval_s / self._settings.tracking_s)
            self.integral -= math.copysign(min(give, abs(self.integral)), saturation)

    def _faded(self, output: float, interval_s: float) -> float:
        if self._present is not None:
            self._step, self._present = self._present - output, None
        else:
            self._step *= math.exp(-interval_s / self._settings.bumpless_s)
        return output + self._step

    def _limited(self, output: float) -> float:
        limited = min(max(output, self._lowest), self._highest)
        self._excess = output - limited
        return limited
