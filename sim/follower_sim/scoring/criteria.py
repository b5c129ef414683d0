"""What a pursuit's score has to reach."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

from follower_sim.scenario.scenario import Criteria
from follower_sim.scoring.score import PursuitScore


@dataclass(frozen=True, slots=True)
class CriterionResult:
    """One figure of a score beside its limit.

    Attributes:
        name: what it is, in words.
        value: the figure with its unit, "not measured" if there is none.
        limit: likewise, "" if nothing is asked.
        passed: whether the limit is kept, None if nothing is asked.
    """

    name: str
    value: str
    limit: str
    passed: bool | None

    @property
    def line(self) -> str:
        """The check in one line, e.g. "Target in frame: 97.2 %, wanted ≥ 99.0 %"."""
        return f"{self.name}: {self.value}" + (f", wanted {self.limit}" if self.limit else "")


@dataclass(frozen=True, slots=True)
class _Row:
    """How one figure is read, shown and compared.

    Attributes:
        name: as the table shows it.
        figure: where the score has it.
        show: puts the number into words.
        limit: the name of its limit in the criteria, "" without one.
        at_least: whether the limit is the smallest good value, else it is the largest.
        needed: whether a missing figure breaks the limit.
    """

    name: str
    figure: str | Callable[[PursuitScore], float | None]
    show: Callable[[float], str]
    limit: str = ""
    at_least: bool = False
    needed: bool = True

    def check(self, score: PursuitScore, criteria: Criteria) -> CriterionResult:
        read = attrgetter(self.figure) if isinstance(self.figure, str) else self.figure
        value, limit = read(score), getattr(criteria, self.limit) if self.limit else None
        shown = "not measured" if value is None else self.show(value)
        if limit is None or (value is None and not self.needed):
            return CriterionResult(self.name, shown, "", None)
        bound = f"{'≥' if self.at_least else '≤'} {self.show(limit)}"
        kept = value is not None and (value >= limit if self.at_least else value <= limit)
        return CriterionResult(self.name, shown, bound, kept)


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if math.isfinite(value) else "never"


def _longest_hidden_s(score: PursuitScore) -> float | None:
    return score.identity.longest_hidden_s if score.identity.disappearances else None


def _found_again_s(score: PursuitScore) -> float | None:
    """Return the slowest return; infinite if one never came."""
    return math.inf if score.identity.never_found else score.identity.slowest_found_s


def _milliseconds(value: float) -> str:
    return f"{1e3 * value:.0f} ms"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


_degrees, _number = "{:.2f}°".format, "{:.0f}".format
_yaw_acceleration, _yaw_jerk = "{:.1f}°/s²".format, "{:.0f}°/s³".format
_acceleration, _jerk = "{:.2f} m/s²".format, "{:.2f} m/s³".format

_ROWS = (
    _Row("Time to acquire", "time_to_acquire_s", _seconds, "max_acquire_s"),
    _Row("Approach", "approach_s", _seconds, "max_approach_s"),
    _Row("Scored time after the approach", "scored_s", _seconds),
    _Row("Target in frame", "in_frame_share", _percent, "min_in_frame_share", at_least=True),
    _Row(
        "Line-of-sight error, RMS", "line_of_sight_rms_deg", _degrees, "max_line_of_sight_rms_deg"
    ),
    _Row("Line-of-sight error, 95th percentile", "line_of_sight_p95_deg", _degrees),
    _Row("Line-of-sight error to the seen box, RMS", "line_of_sight_box_rms_seen_deg", _degrees),
    _Row(
        "Range error, median",
        "range_error_median",
        _percent,
        "max_median_range_error",
        needed=False,
    ),
    _Row("Range error, 95th percentile", "range_error_p95", _percent),
    _Row("Time following", "following_share", _percent),
    _Row("Searches begun", "losses", _number, "max_losses"),
    _Row("Re-acquisitions", "reacquisitions", _number),
    _Row("Longest time hidden", _longest_hidden_s, _seconds),
    _Row(
        "Hidden target found again after",
        _found_again_s,
        _seconds,
        "max_found_again_s",
        needed=False,
    ),
    _Row(
        "Longest time on another target",
        "identity.mistaken_s",
        _seconds,
        "max_mistaken_s",
        needed=False,
    ),
    _Row(
        "Tracked frames with the box beside the target",
        "wrong_box_share",
        _percent,
        "max_wrong_box_share",
        needed=False,
    ),
    _Row("Capture to setpoint, median", "delay_median_s", _milliseconds),
    _Row("Capture to setpoint, 99th percentile", "delay_p99_s", _milliseconds),
    _Row("Setpoints changed by the envelope", "limited_share", _percent),
    _Row(
        "Peak commanded acceleration, horizontal",
        "commanded.horizontal_acceleration_m_s2",
        _acceleration,
    ),
    _Row(
        "Peak commanded acceleration, vertical",
        "commanded.vertical_acceleration_m_s2",
        _acceleration,
    ),
    _Row("Peak commanded yaw acceleration", "commanded.yaw_acceleration_deg_s2", _yaw_acceleration),
    _Row("Peak commanded jerk, horizontal", "commanded.horizontal_jerk_m_s3", _jerk),
    _Row("Peak commanded jerk, vertical", "commanded.vertical_jerk_m_s3", _jerk),
    _Row("Peak commanded yaw jerk", "commanded.yaw_jerk_deg_s3", _yaw_jerk),
)


def checks(score: PursuitScore, criteria: Criteria) -> list[CriterionResult]:
    """Return every figure of the score with its limit, for tables."""
    return [row.check(score, criteria) for row in _ROWS]


def verdict(score: PursuitScore, criteria: Criteria) -> list[str]:
    """Return one line for each thing that failed; a pursuit without any has succeeded.

    A target that was never acquired or never approached fails whatever the criteria say.
    """
    if score.time_to_acquire_s is None:
        return ["The target was never followed"]
    if score.approach_s is None:
        return ["The approach was never over: wanted range and direction were not held for 1 s"]
    return [check.line for check in checks(score, criteria) if check.passed is False]
