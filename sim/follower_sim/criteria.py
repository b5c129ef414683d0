"""What a pursuit's score has to reach."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from follower_sim.score import PursuitScore


@dataclass(frozen=True, slots=True)
class Criteria:
    """Limits of a score; None asks for nothing.

    Attributes:
        min_in_frame_share: least share of the scored time with the target in frame.
        max_line_of_sight_rms_deg: largest root mean square of the line-of-sight error.
        max_median_range_error: largest median of the range error, as a share of the wanted range.
        max_acquire_s: longest time from the choice of the target to following it.
        max_approach_s: longest time from then on to the approach's end.
        max_losses: largest number of losses.
        max_found_again_s: longest time from when a hidden target is to be seen again until it is
            tracked; a target that is never found again breaks it, one that is never hidden not.
        max_mistaken_s: longest time for which another target may be tracked.
        max_wrong_box_share: largest share of tracked frames whose box misses the target.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    min_in_frame_share: float | None = 0.99
    max_line_of_sight_rms_deg: float | None = 3.0
    max_median_range_error: float | None = 0.12
    max_acquire_s: float | None = 15.0
    max_approach_s: float | None = 30.0
    max_losses: int | None = None
    max_found_again_s: float | None = None
    max_mistaken_s: float | None = None
    max_wrong_box_share: float | None = 0.02

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and not 0 <= value < math.inf:
                raise ValueError(f"{field.name} is a number from 0 on, not {value}")
        for name in ("min_in_frame_share", "max_wrong_box_share"):
            share = getattr(self, name)
            if share is not None and share > 1:
                raise ValueError(f"{name} is a share from 0 to 1, not {share}")


@dataclass(frozen=True, slots=True)
class Check:
    """One figure of a score beside its limit.

    Attributes:
        name: what it is, in words.
        value: the figure as people read it, "not measured" if there is none.
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
    """How one figure is read, shown and compared."""

    name: str
    figure: Callable[[PursuitScore], float | None]
    show: Callable[[float], str]
    limit: Callable[[Criteria], float | None] = lambda _: None
    at_least: bool = False
    needed: bool = True
    """Whether a missing figure breaks the limit."""

    def check(self, score: PursuitScore, criteria: Criteria) -> Check:
        value, limit = self.figure(score), self.limit(criteria)
        shown = "not measured" if value is None else self.show(value)
        if limit is None or (value is None and not self.needed):
            return Check(self.name, shown, "", None)
        bound = f"{'≥' if self.at_least else '≤'} {self.show(limit)}"
        return Check(self.name, shown, bound, self._kept(value, limit))

    def _kept(self, value: float | None, limit: float) -> bool:
        if value is None:
            return False
        return value >= limit if self.at_least else value <= limit


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if math.isfinite(value) else "never"


def _longest_hidden_s(score: PursuitScore) -> float | None:
    return score.identity.longest_hidden_s if score.identity.disappearances else None


def _found_again_s(score: PursuitScore) -> float | None:
    """Return the slowest return; without end if there was one too many."""
    return math.inf if score.identity.never_found else score.identity.slowest_found_s


def _milliseconds(value: float) -> str:
    return f"{1e3 * value:.0f} ms"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _degrees(value: float) -> str:
    return f"{value:.2f}°"


def _number(value: float) -> str:
    return f"{value:.0f}"


_ROWS = (
    _Row(
        "Time to acquire",
        lambda s: s.time_to_acquire_s,
        _seconds,
        lambda c: c.max_acquire_s,
    ),
    _Row("Approach", lambda s: s.approach_s, _seconds, lambda c: c.max_approach_s),
    _Row("Scored time after the approach", lambda s: s.scored_s, _seconds),
    _Row(
        "Target in frame",
        lambda s: s.in_frame_share,
        _percent,
        lambda c: c.min_in_frame_share,
        at_least=True,
    ),
    _Row(
        "Line-of-sight error, RMS",
        lambda s: s.line_of_sight_rms_deg,
        _degrees,
        lambda c: c.max_line_of_sight_rms_deg,
    ),
    _Row("Line-of-sight error, 95th percentile", lambda s: s.line_of_sight_p95_deg, _degrees),
    _Row(
        "Range error, median",
        lambda s: s.range_error_median,
        _percent,
        lambda c: c.max_median_range_error,
        needed=False,
    ),
    _Row("Range error, 95th percentile", lambda s: s.range_error_p95, _percent),
    _Row("Time following", lambda s: s.following_share, _percent),
    _Row("Losses", lambda s: s.losses, _number, lambda c: c.max_losses),
    _Row("Re-acquisitions", lambda s: s.reacquisitions, _number),
    _Row("Longest time hidden", _longest_hidden_s, _seconds),
    _Row(
        "Hidden target found again after",
        _found_again_s,
        _seconds,
        lambda c: c.max_found_again_s,
        needed=False,
    ),
    _Row(
        "Longest time on another target",
        lambda s: s.identity.mistaken_s,
        _seconds,
        lambda c: c.max_mistaken_s,
        needed=False,
    ),
    _Row(
        "Tracked frames with the box beside the target",
        lambda s: s.wrong_box_share,
        _percent,
        lambda c: c.max_wrong_box_share,
        needed=False,
    ),
    _Row("Capture to setpoint, median", lambda s: s.delay_median_s, _milliseconds),
    _Row("Capture to setpoint, 99th percentile", lambda s: s.delay_p99_s, _milliseconds),
    _Row("Setpoints changed by the envelope", lambda s: s.limited_share, _percent),
    _Row(
        "Peak commanded acceleration, horizontal",
        lambda s: s.commanded.horizontal_acceleration_m_s2,
        lambda v: f"{v:.2f} m/s²",
    ),
    _Row(
        "Peak commanded acceleration, vertical",
        lambda s: s.commanded.vertical_acceleration_m_s2,
        lambda v: f"{v:.2f} m/s²",
    ),
    _Row(
        "Peak commanded yaw acceleration",
        lambda s: s.commanded.yaw_acceleration_deg_s2,
        lambda v: f"{v:.1f}°/s²",
    ),
    _Row(
        "Peak commanded jerk, horizontal",
        lambda s: s.commanded.horizontal_jerk_m_s3,
        lambda v: f"{v:.2f} m/s³",
    ),
    _Row(
        "Peak commanded jerk, vertical",
        lambda s: s.commanded.vertical_jerk_m_s3,
        lambda v: f"{v:.2f} m/s³",
    ),
    _Row(
        "Peak commanded yaw jerk",
        lambda s: s.commanded.yaw_jerk_deg_s3,
        lambda v: f"{v:.0f}°/s³",
    ),
)


def checks(score: PursuitScore, criteria: Criteria) -> list[Check]:
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
