"""Gains from a model: as fast as is wanted, or as is allowed.

The robustness is asked for as the largest sensitivity, after Åström and Hägglund, "Advanced PID
Control", ch. 4 and 7: Ms ≤ 1.6 leaves a gain margin of at least 2.7 and a phase margin of at least
36 degrees.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from follower_control.common.strict_config import check_positive, check_ranges
from follower_control.servo.pid import PidSettings
from follower_control.tuning.axes import Axis, LoopSettings, axis_loop
from follower_control.tuning.axis_loop import AxisLoop, Conditions
from follower_control.tuning.rational import bandwidth_rad_s, frequencies, max_sensitivity_of
from follower_control.tuning.response_model import VehicleModel

_GRID = frequencies(highest_rad_s=40.0)[::3]
_STEP, _REFINEMENTS = 1.25, 4
_LOWEST, _HIGHEST = 0.05, 20.0
_INTEGRAL_PER_S = {Axis.AZIMUTH: (0.0,), Axis.ELEVATION: (0.05, 0.125), Axis.RANGE: (0.05, 0.1)}
"""Integral gain over proportional gain, to choose from; the present ratio is tried too."""
_DERIVATIVE_S = {Axis.AZIMUTH: (0.0,), Axis.ELEVATION: (0.0, 0.2), Axis.RANGE: (0.0, 0.3, 0.6, 1.0)}
"""Derivative gain over proportional gain, likewise."""
_HIGHEST_RATIO = 1e4
"""A present ratio above this is not tried: raised with it, gains leave what a loop may have."""
_USUAL_ERROR = {Axis.AZIMUTH: 0.15, Axis.ELEVATION: 0.08, Axis.RANGE: 0.2}
_SMOOTH_PEAK = 1.25
"""What is wanted is followed without more resonance than this; a steady error aside."""


@dataclass(frozen=True, slots=True)
class TuningGoal:
    """What a loop is to be like.

    Attributes:
        bandwidth_rad_s: up to which frequency it is to follow; None: as fast as the rest allows.
        max_sensitivity: Ms.
        jitter_factor: by how much the setpoints may shake more than with the present gains.
    """

    bandwidth_rad_s: float | None = None
    max_sensitivity: float = 1.6
    jitter_factor: float = 1.5

    def __post_init__(self) -> None:
        check_ranges(self, bandwidth_rad_s=(0.01, 30), max_sensitivity=(1.1, 4))
        check_positive(self, "jitter_factor")


@dataclass(frozen=True, slots=True)
class Tuned:
    """Gains, the loop that they make, and what kept them from being higher.

    Attributes:
        gains: of the loop.
        loop: with them.
        reached: whether all goals hold.
        because: what the gains end at, in words.
    """

    gains: PidSettings
    loop: AxisLoop
    reached: bool
    because: str


@dataclass(frozen=True, slots=True)
class _Candidate:
    gains: PidSettings
    bandwidth_rad_s: float
    sensitivity: float
    because: str


def tune(
    axis: Axis,
    vehicle: VehicleModel,
    follower: LoopSettings,
    conditions: Conditions,
    goal: TuningGoal,
) -> Tuned:
    """Return gains for one axis.

    For each ratio of integral and derivative to proportional gain, the gain is raised from almost
    nothing until one of the goals would no longer hold. Of the ends, the one with the highest
    bandwidth is taken; with a bandwidth asked for, of those that reach it, the most robust one.
    """
    search = _Search(axis, vehicle, follower, conditions, goal)
    ends = [one for start in search.starts() if (one := search.raised(start)) is not None]
    found = [one for one in ends if search.settles(one.gains)]
    if not found:
        present = follower.gains(axis)
        loop = axis_loop(axis, present, vehicle, follower, conditions)
        return Tuned(present, loop, False, f"{search.why_none(ends)}: kept as they are")
    best = max(found, key=lambda one: one.bandwidth_rad_s)
    wanted = goal.bandwidth_rad_s
    reached = wanted is None or best.bandwidth_rad_s >= 0.97 * wanted
    if wanted is not None and reached:
        able = [one for one in found if one.bandwidth_rad_s >= 0.97 * wanted]
        best = min(able, key=lambda one: one.sensitivity)
    loop = axis_loop(axis, best.gains, vehicle, follower, conditions)
    return Tuned(best.gains, loop, reached, best.because)


class _Search:
    def __init__(
        self,
        axis: Axis,
        vehicle: VehicleModel,
        follower: LoopSettings,
        conditions: Conditions,
        goal: TuningGoal,
    ) -> None:
        self._axis, self._vehicle, self._follower = axis, vehicle, follower
        self._conditions, self._goal = conditions, goal
        self._present = follower.gains(axis)
        jitter = self._loop(self._present).jitter()
        # Gains of zero do not shake: nothing to compare others with.
        self._most_jitter = goal.jitter_factor * jitter if jitter > 0 else math.inf

    def starts(self) -> Iterator[PidSettings]:
        """Yield gains of almost nothing with each ratio between them."""
        present, axis = self._present, self._axis
        for integral in self._ratios(_INTEGRAL_PER_S[axis], present.ki):
            for derivative in self._ratios(_DERIVATIVE_S[axis], present.kd):
                ki, kd = _LOWEST * integral, _LOWEST * derivative
                yield replace(present, kp=_LOWEST, ki=ki, kd=kd)

    def _ratios(self, usual: Sequence[float], present: float) -> list[float]:
        """Return which ratios to the proportional gain to try; to one of zero there is none."""
        ratio = present / self._present.kp if self._present.kp else math.inf
        return sorted({*usual, round(ratio, 4)} if ratio <= _HIGHEST_RATIO else usual)

    def raised(self, gains: PidSettings) -> _Candidate | None:
        """Return the highest of these gains up to which everything holds, None if none does."""
        best: _Candidate | None = None
        while gains.kp < _HIGHEST:
            candidate = self._judged(gains)
            if not candidate.because:
                best = candidate
            elif best is not None:
                # A weak loop with an integral swings too: what fails before it holds is no end.
                return self._refined(best, candidate)
            gains = _times(gains, _STEP)
        return best

    def _refined(self, holds: _Candidate, fails: _Candidate) -> _Candidate:
        """Return the highest gains between some that hold and some that do not."""
        factor = fails.gains.kp / holds.gains.kp
        for _ in range(_REFINEMENTS):
            factor = math.sqrt(factor)
            middle = self._judged(_times(holds.gains, factor))
            if middle.because:
                fails = middle
            else:
                holds = middle
        return replace(holds, because=fails.because)

    def why_none(self, ends: Sequence[_Candidate]) -> str:
        """Return why none of the ends, if any, will do."""
        if ends:
            return "no gains make a stable loop"
        whys = {self._judged(start).because for start in self.starts()}
        return f"even with the weakest gains tried, {' or '.join(sorted(whys))}"

    def settles(self, gains: PidSettings) -> bool:
        """Whether the closed loop is stable, by its poles."""
        return self._loop(gains).is_stable()

    def _judged(self, gains: PidSettings) -> _Candidate:
        """Return what gains are worth, and what does not hold with them."""
        loop, goal = self._loop(gains), self._goal
        following = loop.following(_GRID)
        bandwidth = bandwidth_rad_s(_GRID, following)
        sensitivity = max_sensitivity_of(loop.open_loop(_GRID))
        because = ""
        if sensitivity > 0.995 * goal.max_sensitivity:
            because = f"Ms reaches {goal.max_sensitivity:g}"
        elif goal.bandwidth_rad_s is not None and bandwidth > 1.03 * goal.bandwidth_rad_s:
            because = f"the wanted bandwidth of {goal.bandwidth_rad_s:g} rad/s is there"
        elif float(np.abs(following).max()) > max(_SMOOTH_PEAK, goal.max_sensitivity / 1.2):
            because = "it would swing about what is wanted"
        elif loop.jitter() > self._most_jitter:
            because = f"the setpoints shake {goal.jitter_factor:g} times as much as now"
        elif self._demand(loop, gains, bandwidth) > 1.0:
            because = "a usual error asks for all that servo and envelope allow"
        return _Candidate(gains, bandwidth, sensitivity, because)

    def _demand(self, loop: AxisLoop, gains: PidSettings, bandwidth_rad_s: float) -> float:
        """Return what a usual error asks for, over what servo and envelope allow."""
        envelope, servo = self._follower.envelope, self._follower.servo
        error = _USUAL_ERROR[self._axis]
        asked = loop.motion_scale * gains.kp * error
        fastest, hardest = {
            Axis.AZIMUTH: (
                min(envelope.max_yaw_rate_deg_s, servo.max_yaw_rate_deg_s),
                envelope.max_yaw_acceleration_deg_s2,
            ),
            Axis.ELEVATION: (
                min(envelope.max_climb_m_s, envelope.max_descent_m_s, servo.max_vertical_m_s),
                envelope.max_acceleration_m_s2,
            ),
            Axis.RANGE: (
                min(envelope.max_speed_m_s, servo.max_forward_m_s),
                envelope.max_acceleration_m_s2,
            ),
        }[self._axis]
        asked = math.degrees(asked) if self._axis is Axis.AZIMUTH else asked
        return max(asked / fastest, asked * bandwidth_rad_s / hardest)

    def _loop(self, gains: PidSettings) -> AxisLoop:
        return axis_loop(self._axis, gains, self._vehicle, self._follower, self._conditions)


def _times(gains: PidSettings, factor: float) -> PidSettings:
    return replace(gains, kp=gains.kp * factor, ki=gains.ki * factor, kd=gains.kd * factor)
