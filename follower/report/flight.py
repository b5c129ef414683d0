"""What a report is about: one flight, prepared once for all its figures and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from follower.flightlog import FlightLog
from follower.report.series import (
    Motion,
    Span,
    end_of,
    start_of,
    state_spans,
    telemetry_motion,
    track_spans,
    true_motion,
)
from follower.supervisor import State
from follower_sim.score import PursuitGoal, PursuitScore
from follower_sim.truth_sample import TruthSample


@dataclass(frozen=True, slots=True)
class Flight:
    """A flight's log with the truth, if there is one; times count from `start_s`.

    Attributes:
        log: what happened.
        truth: the simulator's samples, empty for a real flight or a recording.
        goal: what was wanted, None if that is unknown.
        target_size_m: the servo's belief about the target's size, None if it has none.
        start_s: the flight's first moment on the system's clock.
        length_s: from then to its last.
        states: the supervisor's states.
        seen: vision's states.
        motion: the vehicle's true motion, or what telemetry says of it.
        approached_s: when the approach was over, None if it never was or nobody knows.
    """

    log: FlightLog
    truth: Sequence[TruthSample]
    goal: PursuitGoal | None
    target_size_m: float | None
    start_s: float
    length_s: float
    states: list[Span]
    seen: list[Span]
    motion: Motion
    approached_s: float | None

    @classmethod
    def of(
        cls,
        log: FlightLog,
        truth: Sequence[TruthSample] = (),
        goal: PursuitGoal | None = None,
        target_size_m: float | None = None,
        score: PursuitScore | None = None,
    ) -> Flight:
        """Prepare a flight."""
        start_s = start_of(log, truth)
        motion = true_motion(truth, start_s) if truth else telemetry_motion(log.controls, start_s)
        return cls(
            log=log,
            truth=truth,
            goal=goal,
            target_size_m=target_size_m,
            start_s=start_s,
            length_s=max(0.0, end_of(log) - start_s),
            states=state_spans(log.controls, start_s),
            seen=track_spans(log.tracks, start_s),
            motion=motion,
            approached_s=_approached_s(log, start_s, score),
        )


def _approached_s(log: FlightLog, start_s: float, score: PursuitScore | None) -> float | None:
    if score is None or score.approach_s is None:
        return None
    acquired = (r.time_s for r in log.controls if r.state is State.FOLLOWING)
    first_s = next(acquired, None)
    return None if first_s is None else first_s - start_s + score.approach_s
