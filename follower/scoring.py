"""From a flight's log to its score: what the simulator's score needs, as plain values."""

from __future__ import annotations

from collections.abc import Sequence

from follower.flightlog import ControlRecord, FlightLog
from follower.supervisor import Reason, State
from follower_sim.commanded import PursuitStep
from follower_sim.identity_score import IdentityScore
from follower_sim.score import PursuitGoal, PursuitScore, pursuit_score
from follower_sim.truth_sample import TruthSample


def score_flight(
    log: FlightLog,
    truth: Sequence[TruthSample],
    goal: PursuitGoal,
    *,
    overlaps: Sequence[float] = (),
    identity: IdentityScore | None = None,
    chosen_s: float | None = None,
) -> PursuitScore:
    """Score a flight up to the operator's stop, or to its end if nobody stopped it.

    Args:
        log: the flight.
        truth: samples on the log's clock, in the order of time.
        goal: what was wanted.
        identity: what became of the target's identity, if it is known.
        overlaps: intersection over union with the true box, one for each tracked frame.
        chosen_s: when the operator asked for the target, if it is known.
    """
    return pursuit_score(
        truth,
        [_pursuit_step(record) for record in log.controls],
        goal,
        delays_s=setpoint_delays(log.controls),
        overlaps=overlaps,
        identity=identity,
        chosen_s=chosen_s,
        end_s=stopped_s(log.controls),
    )


def setpoint_delays(controls: Sequence[ControlRecord]) -> list[float]:
    """Return, for each frame that was steered by, the time from its capture to the setpoint.

    That is the beginning of the first step that used the frame's track and sent what the servo
    made of it; how long the step itself takes is `ControlRecord.busy_s`.
    """
    delays: list[float] = []
    used_s: float | None = None
    for record in controls:
        captured_s = record.track_captured_s
        if captured_s is None or captured_s == used_s:
            continue
        used_s = captured_s
        if record.sent and record.state is State.FOLLOWING:
            delays.append(record.time_s - captured_s)
    return delays


def stopped_s(controls: Sequence[ControlRecord]) -> float | None:
    """Return when the operator's stop took effect, None if it never did."""
    return next((r.time_s for r in controls if r.reason is Reason.STOP_REQUESTED), None)


def _pursuit_step(record: ControlRecord) -> PursuitStep:
    setpoint = record.allowed if record.sent else None
    return PursuitStep(record.time_s, str(record.state), setpoint, tuple(map(str, record.limits)))
