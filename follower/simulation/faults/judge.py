"""Holds a flight against what its fault's sentence says."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from follower.faults.evidence import Evidence, Motion, WireSetpoint
from follower.faults.fault import Kind, Outcome
from follower.faults.planned import PlannedFault
from follower.faults.verdict import Figures, Verdict
from follower.faults.wire_rules import (
    age_failures,
    envelope_failures,
    input_failures,
    left_mode,
    pilot_failures,
    told_of_leaving,
)
from follower.flightlog import ControlRecord
from follower.supervisor import Reason, State
from follower_control.envelope_settings import EnvelopeSettings
from follower_sim.truth_sample import TruthSample

STANDING_M_S = 0.5
STEP_S = 0.02
WIRE_WITHIN_S = 0.1
_STANDS_FOR_S = 1.0
_FOLLOWS_FOR_S = 0.5
_NOTICED_WITHIN_S = 1.0
_NEARER_M = 0.75
_HEIGHT_M = 1.0


@dataclass(frozen=True, slots=True)
class Case:
    """A flight with one fault, all that its judge needs.

    Attributes:
        planned: the fault.
        from_s, until_s: when it was there; None if it never began.
        evidence: the watcher's.
        controls: the follower's own record, for when it decided what.
        truth: for the distance to the target.
        limits: of the envelope.
        alone: no other fault was in the flight, and this one was as the catalogue has it.
        realtime: set-points leave some time after their step, and not always the same.
        error: what was raised and caught by nobody, "" if nothing.
    """

    planned: PlannedFault
    from_s: float | None
    until_s: float
    evidence: Evidence
    controls: Sequence[ControlRecord]
    truth: Sequence[TruthSample]
    limits: EnvelopeSettings
    alone: bool = True
    error: str = ""
    realtime: bool = False


def judge(case: Case) -> Verdict:
    """Return what came of it."""
    last = case.controls[-1] if case.controls else None
    end = "" if last is None else f"{last.state} ({last.reason})"
    figures = _figures(case)
    failures = tuple(_failures(case, figures))
    must = case.planned.fault.must if case.alone else ""
    return Verdict(str(case.planned), must, failures, figures, end)


def _failures(case: Case, figures: Figures) -> Iterator[str]:
    if case.error:
        yield f"an error that nobody caught: {case.error}"
    yield from _always(case)
    if case.from_s is None:
        yield "the fault never began: the flight did not come so far"
        return
    if case.alone:
        yield from _too_late(case, figures)
        yield from _OUTCOMES[case.planned.fault.outcome](case, case.from_s, figures)


def _always(case: Case) -> Iterator[str]:
    """Yield what is against the rules that hold for every fault."""
    setpoints = case.evidence.setpoints
    unsure_s = case.limits.max_interval_s if case.realtime else STEP_S
    yield from envelope_failures(setpoints, case.limits, unsure_s)
    yield from pilot_failures(case.evidence, ())
    yield from age_failures(setpoints, case.controls)
    yield from input_failures(case.controls, setpoints)
    yield from _place_failures(case)
    last = case.evidence.motion[-1]
    if last.obeys and last.speed_m_s > STANDING_M_S:
        yield f"it flies on at {last.speed_m_s:.1f} m/s at the end, in nobody's hands"


def _place_failures(case: Case) -> Iterator[str]:
    limits = case.limits
    nearest = min((sample.range_m for sample in case.truth), default=math.inf)
    if limits.min_distance_m is not None and nearest < limits.min_distance_m - _NEARER_M:
        yield f"it comes as near as {nearest:.1f} m to the target"
    flown = [m for m in case.evidence.motion if m.obeys and m.armed]
    heights = [-m.position_m[2] for m in flown]
    if limits.ceiling_m is not None and max(heights, default=0.0) > limits.ceiling_m + _HEIGHT_M:
        yield f"it climbs to {max(heights):.1f} m"
    if limits.fence_radius_m is not None:
        away = max((math.hypot(*m.position_m[:2]) for m in flown), default=0.0)
        if away > limits.fence_radius_m + 2.0:
            yield f"it flies {away:.0f} m away"


def _too_late(case: Case, figures: Figures) -> Iterator[str]:
    fault = case.planned.fault
    limits = (
        ("a hold on the wire", figures.hold_s, fault.hold_within_s, "s"),
        ("standing still", figures.rest_s, fault.rest_within_s, "s"),
        ("the excursion", figures.excursion_m, fault.excursion_m, "m"),
    )
    for what, value, most, unit in limits:
        if most is not None and value is None:
            yield f"{what}: never"
        elif most is not None and value is not None and value > most:
            yield f"{what}: {value:.2f} {unit}, more than {most:.2f}"
    if figures.wire_s is not None and figures.wire_s > WIRE_WITHIN_S:
        yield f"the hold was on the wire {1e3 * figures.wire_s:.0f} ms after its decision"


def _carries_on(case: Case, from_s: float, figures: Figures) -> Iterator[str]:
    fault = case.planned.fault
    until_s = min(case.until_s, case.controls[-1].time_s)
    during = [c for c in case.controls if from_s <= c.time_s <= until_s]
    held = [c for c in during if not c.state.steers]
    if held and fault.back_within_s is None:
        yield f"{held[0].time_s - from_s:.2f} s on: {held[0].state} ({held[0].reason})"
    yield from _back(figures, fault.back_within_s or 0.5)


def _comes_back(case: Case, _from_s: float, figures: Figures) -> Iterator[str]:
    lost = [m for m in left_mode(case.evidence.motion) if m < case.until_s + 1.0]
    if lost and any(left_s > _from_s for left_s in lost):
        return  # the autopilot's own failsafe was faster; the pilot's rules hold
    yield from _back(figures, case.planned.fault.back_within_s or 3.0)


def _back(figures: Figures, within_s: float) -> Iterator[str]:
    if figures.back_s is None:
        yield "it does not follow again"
    elif figures.back_s > within_s:
        yield f"it follows again after {figures.back_s:.2f} s, not within {within_s:.2f} s"


def _lets_go(case: Case, from_s: float, _figures: Figures) -> Iterator[str]:
    later = [c for c in case.controls if c.time_s > from_s]
    released = [number for number, c in enumerate(later) if c.state is State.RELEASED]
    asked = any(a.kind is Kind.STOP_REQUESTED for a in case.planned.fault.actions)
    if not released or (later[released[0]].reason is Reason.STOP_REQUESTED and not asked):
        yield "it never lets go"
    elif any(c.state is not State.RELEASED for c in later[released[0] :]):
        yield "it does not stay let go"


def _pilot_has_it(case: Case, from_s: float, figures: Figures) -> Iterator[str]:
    yield from _lets_go(case, from_s, figures)
    if figures.after_pilot_s is None:
        yield "the autopilot stayed in the mode that flies set-points"


def _never_follows(case: Case, _from_s: float, _figures: Figures) -> Iterator[str]:
    if any(c.state.engaged for c in case.controls):
        yield "it follows"
    if any(not s.is_zero for s in case.evidence.setpoints):
        yield "something else than zero is sent"


def _ends_in_mode(case: Case, from_s: float, figures: Figures) -> Iterator[str]:
    yield from _lets_go(case, from_s, figures)
    fault = case.planned.fault
    wanted = dict(fault.ends_in)[case.evidence.flavour]
    mode = next((m.mode for m in case.evidence.motion if m.time_s >= case.until_s), "no mode")
    if mode != wanted:
        yield f"{case.until_s - from_s:.0f} s on it is in {mode}, not in {wanted}"
    last_s = max((s.time_s for s in case.evidence.setpoints), default=from_s) - from_s
    if fault.silent_within_s is not None and last_s > fault.silent_within_s:
        yield f"a set-point {last_s:.1f} s on, not within {fault.silent_within_s:.1f} s"
    if fault.silent_within_s is None and last_s < case.until_s - from_s:
        yield f"the last set-point came {last_s:.1f} s on"


_OUTCOMES = {
    Outcome.CARRIES_ON: _carries_on,
    Outcome.COMES_BACK: _comes_back,
    Outcome.LETS_GO: _lets_go,
    Outcome.PILOT_HAS_IT: _pilot_has_it,
    Outcome.NEVER_FOLLOWS: _never_follows,
    Outcome.ENDS_IN_MODE: _ends_in_mode,
}


def _figures(case: Case) -> Figures:
    setpoints = case.evidence.setpoints
    if case.from_s is None:
        return Figures(setpoints=len(setpoints))
    hold = _first_hold(case.controls, case.from_s, case.until_s)
    sent = None if hold is None else _first_at(setpoints, hold.time_s)
    stops = case.planned.fault.rest_within_s is not None
    rest_s = _standing_from(case.evidence.motion, case.from_s) if stops else None
    return Figures(
        hold_s=None if sent is None else sent.time_s - case.from_s,
        wire_s=None if sent is None or hold is None or not hold.sent else sent.time_s - hold.time_s,
        rest_s=None if rest_s is None else rest_s - case.from_s,
        excursion_m=None if rest_s is None else _excursion(case, case.from_s, rest_s),
        back_s=_back_after(case),
        after_pilot_s=_after_pilot(case.evidence, case.from_s),
        setpoints=len(setpoints),
    )


def _first_hold(
    controls: Sequence[ControlRecord], from_s: float, until_s: float
) -> ControlRecord | None:
    """Return the first step that holds, of those that can have the fault for their reason."""
    later = (c for c in controls if from_s <= c.time_s <= until_s + _NOTICED_WITHIN_S)
    return next((c for c in later if c.state in _HOLDS), None)


_HOLDS = (State.SEARCHING, State.HOLDING, State.RELEASED)


def _first_at(setpoints: Sequence[WireSetpoint], time_s: float) -> WireSetpoint | None:
    return next((s for s in setpoints if s.time_s >= time_s - 1e-6), None)


def _standing_from(motion: Sequence[Motion], from_s: float) -> float | None:
    """Return from when on the vehicle stands for a second, or to the end."""
    since: float | None = None
    for sample in motion:
        if sample.time_s < from_s or sample.speed_m_s > STANDING_M_S:
            since = None
        elif since is None:
            since = sample.time_s
        if since is not None and sample.time_s - since > _STANDS_FOR_S:
            return since
    return since


def _excursion(case: Case, from_s: float, until_s: float) -> float:
    places = [m.position_m for m in case.evidence.motion if from_s <= m.time_s <= until_s]
    return max((math.dist(places[0], place) for place in places), default=0.0)


def _back_after(case: Case) -> float | None:
    """Return how long after the fault's end the target is followed for some time."""
    since: float | None = None
    for record in case.controls:
        if record.time_s < case.until_s or record.state is not State.FOLLOWING:
            since = None
        elif since is None:
            since = record.time_s
        if since is not None and record.time_s - since >= _FOLLOWS_FOR_S:
            return since - case.until_s
    return None


def _after_pilot(evidence: Evidence, from_s: float) -> float | None:
    """Return how long set-points went on after the first heartbeat that told of another mode."""
    left_s = next((t for t in left_mode(evidence.motion) if t >= from_s), None)
    if left_s is None:
        return None
    told_s = told_of_leaving(evidence, left_s)
    late = [s.time_s - told_s for s in evidence.setpoints if s.time_s > told_s and not s.is_zero]
    return max(late, default=0.0)
