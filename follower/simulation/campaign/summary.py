"""What a campaign's runs come to: each goal, met or not, with how sure that is."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from follower.simulation.campaign.config import Goals
from follower.simulation.campaign.metrics import RunMetrics
from follower_sim.scoring.identity_score import WrongEnd

_NOT_FOLLOWED = 20.0
_VIOLATION = _WRONG_END = 5.0


def cost(figures: RunMetrics) -> float:
    """Return a run's cost.

    The line-of-sight error over 3 degrees, occlusions left out, and the range error over 12 %
    count once each, time out of the frame ten times, a late second of re-acquisition half;
    smoothness a little, so that of two settings that follow as well, the quieter one is cheaper. A
    broken limit costs 5, a target that is gone at the end too, another one in its place 10, not to
    follow at all 20.
    """
    if figures.line_of_sight_box_rms_seen_deg is None or figures.approach_s is None:
        return _NOT_FOLLOWED
    total = figures.line_of_sight_box_rms_seen_deg / 3 + (figures.range_error_median or 0.0) / 0.12
    total += 10 * (1 - (figures.in_frame_share or 0.0))
    waits = [3.0 if took is None else min(took, 3.0) for took in figures.reacquired_s]
    total += 0.5 * sum(waits) / max(1, len(waits))
    total += 0.2 * (figures.acceleration_rms_m_s2 or 0.0)
    total += 0.005 * (figures.yaw_acceleration_rms_deg_s2 or 0.0)
    if figures.wrong_end is not None:
        total += _WRONG_END * (1 + WrongEnd(figures.wrong_end).is_swap)
    return total + _VIOLATION * (figures.envelope_violations + figures.is_too_near)


_Z_95 = 1.959963984540054


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Return the score interval of a share (Wilson, 1927); (0, 1) where nothing was counted.

    Raises:
        ValueError: there are fewer than none, or more successes than tries.
    """
    if not 0 <= successes <= count:
        raise ValueError(f"{successes} of {count} is no share")
    if count == 0:
        return 0.0, 1.0
    share, z, z2 = successes / count, _Z_95, _Z_95**2
    middle = share + z2 / (2 * count)
    half = z * math.sqrt(share * (1 - share) / count + z2 / (4 * count * count))
    scale = 1 + z2 / count
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


@dataclass(frozen=True, slots=True)
class GoalLine:
    """One goal over all runs.

    Attributes:
        name: in words.
        value: what was reached, as text.
        wanted: likewise.
        met: whether the value is what was wanted.
        counts: whether it is a goal of this campaign; else it is shown beside them.
    """

    name: str
    value: str
    wanted: str
    met: bool
    counts: bool = True

    @property
    def verdict(self) -> str:
        """Return "met", "not met", or "" where there is nothing to meet."""
        if not self.counts:
            return ""
        return "met" if self.met else "not met"


@dataclass(frozen=True, slots=True)
class CampaignSummary:
    """Everything in a few numbers.

    Attributes:
        runs: how many.
        passed: of them, those that reached every goal.
        errors: of them, those that could not be flown.
        lines: the goals.
        failures: how often each goal was missed, the most frequent first.
        worst: the runs that failed, the worst first.
    """

    runs: int
    passed: int
    errors: int
    lines: tuple[GoalLine, ...]
    failures: tuple[tuple[str, int], ...]
    worst: tuple[dict[str, Any], ...]

    @property
    def reached(self) -> bool:
        """Whether every goal was met."""
        return self.errors == 0 and all(line.met for line in self.goals)

    @property
    def goals(self) -> tuple[GoalLine, ...]:
        """The lines that count."""
        return tuple(line for line in self.lines if line.counts)


def summary_of(rows: Sequence[dict[str, Any]], goals: Goals) -> CampaignSummary:
    """Sum up judged rows."""
    flown = [row for row in rows if not row["error"]]
    figures = [RunMetrics.from_dict(row) for row in flown]
    failures = Counter(name for row in rows for name in row["failures"])
    return CampaignSummary(
        len(rows),
        sum(row["passed"] for row in rows),
        len(rows) - len(flown),
        _lines(figures, goals),
        tuple(failures.most_common()),
        tuple(sorted((row for row in rows if not row["passed"]), key=_badness, reverse=True)),
    )


def share_text(successes: int, count: int) -> str:
    """Return a counted share with its 95 % interval."""
    if count == 0:
        return "nothing counted"
    low, high = wilson(successes, count)
    share = 100 * successes / count
    return f"{share:.1f} % ({100 * low:.1f}–{100 * high:.1f} %; {successes} of {count})"


def _lines(figures: Sequence[RunMetrics], goals: Goals) -> tuple[GoalLine, ...]:
    return (
        _followed(figures),
        _in_frame(figures, goals),
        _reacquired(figures, goals),
        _line_of_sight(
            "Line-of-sight error, RMS, outside occlusions",
            [one.line_of_sight_box_rms_seen_deg for one in figures],
            goals,
        ),
        _line_of_sight(
            "Line-of-sight error, RMS, occlusions and all",
            [one.line_of_sight_rms_deg for one in figures],
            goals,
            counts=False,
        ),
        _none_of("Wrong ends", [one.wrong_end is not None for one in figures]),
        _none_of(
            "Envelope violations",
            [one.envelope_violations > goals.max_violations for one in figures],
        ),
        _none_of(
            "Runs inside the target's keep-out",
            [one.is_too_near for one in figures],
            goals.keep_out,
        ),
    )


def _followed(figures: Sequence[RunMetrics]) -> GoalLine:
    good = sum(one.approach_s is not None for one in figures)
    count = len(figures)
    value = share_text(good, count)
    met = count > 0 and good == count
    return GoalLine("Target acquired and approached", value, "100 %", met)


def _in_frame(figures: Sequence[RunMetrics], goals: Goals) -> GoalLine:
    """Weigh each run by its scored time; a run that never approached had nothing in frame."""
    scored = [(one.in_frame_share or 0.0, one.scored_s) for one in figures]
    total_s = sum(seconds for _, seconds in scored)
    share = sum(part * seconds for part, seconds in scored) / total_s if total_s else 0.0
    good = sum((one.in_frame_share or 0.0) >= goals.min_in_frame_share for one in figures)
    value = f"{100 * share:.2f} % of the time; runs: {share_text(good, len(figures))}"
    wanted = f"≥ {100 * goals.min_in_frame_share:g} % of the time"
    met = share >= goals.min_in_frame_share
    name = "Target in frame, outside occlusions"
    return GoalLine(name, value, wanted, met)


def _reacquired(figures: Sequence[RunMetrics], goals: Goals) -> GoalLine:
    count = sum(len(goals.short(one)) for one in figures)
    good = count - sum(goals.late(one) for one in figures)
    name = f"Re-acquired within {goals.reacquired_s:g} s, occlusions up to {goals.occlusion_s:g} s"
    wanted = f"≥ {100 * goals.reacquired_share:g} % of them"
    met = count > 0 and good / count >= goals.reacquired_share
    return GoalLine(name, share_text(good, count), wanted, met, count > 0)


def reacquired_by_length(figures: Sequence[RunMetrics], within_s: float) -> list[tuple[str, str]]:
    """Return for each whole second of cover, in words, the share re-acquired within a time."""
    pairs = [
        (int(length), took)
        for one in figures
        for length, took in zip(one.occlusion_s, one.reacquired_s, strict=True)
    ]
    waits = {
        second: [math.inf if took is None else took for length, took in pairs if length == second]
        for second in sorted({length for length, _ in pairs})
    }
    return [
        (f"{s}–{s + 1} s", share_text(sum(wait <= within_s for wait in of_length), len(of_length)))
        for s, of_length in waits.items()
    ]


def _line_of_sight(
    name: str, angles: Sequence[float | None], goals: Goals, counts: bool = True
) -> GoalLine:
    known = [angle for angle in angles if angle is not None]
    limit = goals.max_line_of_sight_rms_deg
    good = sum(angle <= limit for angle in known)
    pooled = math.sqrt(sum(angle * angle for angle in known) / len(known)) if known else math.inf
    angle = f"{pooled:.2f}° over all" if known else "not measured"
    value = f"{angle}; runs: {share_text(good, len(angles))}"
    return GoalLine(name, value, f"≤ {limit:g}°", pooled <= limit, counts)


def _none_of(name: str, broken: Sequence[bool], counts: bool = True) -> GoalLine:
    value = f"{sum(broken)} of {len(broken)} runs"
    return GoalLine(name, value, "none", len(broken) > 0 and not any(broken), counts)


def _badness(row: dict[str, Any]) -> tuple[float, ...]:
    """Order failed runs: errors, then the number of goals missed, then the cost."""
    if row["error"]:
        return (math.inf, 0.0)
    return float(len(row["failures"])), cost(RunMetrics.from_dict(row))
