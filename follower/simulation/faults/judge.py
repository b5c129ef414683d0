"""Checks a flight against what its fault's sentence demands."""

import math
import signal
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.simulation.faults.fault import ExpectedOutcome, Fault, FaultKind, PlannedFault
from follower.simulation.faults.setpoint_rules import (
    RELEASE_WITHIN_S,
    age_failures,
    envelope_failures,
    input_failures,
    leaving_known_s,
    left_mode,
    pilot_failures,
)
from follower.simulation.faults.wire_tap import FlightEvidence, TrueMotion, WireSetpoint
from follower_control.envelope.fence import Fence
from follower_control.envelope.settings import EnvelopeSettings
from follower_sim.kinematics import TruthSample


@dataclass(frozen=True, slots=True)
class FaultMetrics:
    """What was measured, in seconds and metres; None where it does not apply.

    Attributes:
        hold_s: from the fault's begin to the first hold on the wire.
        wire_s: from the decision to hold to the hold on the wire.
        rest_s: from the fault's begin to the vehicle's standing still.
        excursion_m: how far it went until then.
        back_s: from the fault's end until the target is followed again.
        after_pilot_s: from the heartbeat with the pilot's mode to the last setpoint.
        setpoints: how many went over the wire.
    """

    hold_s: float | None = None
    wire_s: float | None = None
    rest_s: float | None = None
    excursion_m: float | None = None
    back_s: float | None = None
    after_pilot_s: float | None = None
    setpoints: int = 0


@dataclass(frozen=True, slots=True)
class FaultVerdict:
    """One fault in one flight.

    Attributes:
        fault: its name, with time and duration if they were chosen.
        must: the sentence; "" if the flight was held against what always holds alone.
        failures: what was not so, in sentences; none is a pass.
        figures: what was measured.
        end: the supervisor's last state and reason.
    """

    fault: str
    must: str
    failures: tuple[str, ...]
    figures: FaultMetrics
    end: str

    @property
    def passed(self) -> bool:
        """Whether all was as it must be."""
        return not self.failures


STANDING_M_S = 0.5
STEP_S = 0.02
WIRE_WITHIN_S = 0.1
_STANDS_FOR_S = 1.0
_FOLLOWS_FOR_S = 0.5
_NOTICED_WITHIN_S = 1.0
_NEARER_M = 0.75
_HEIGHT_M, _FENCE_M = 1.0, 2.0
_SILENT_WITHIN_S = 0.1
_STOPS_ALONE_WITHIN_S = 9.0


@dataclass(frozen=True, slots=True)
class FaultCase:
    """A flight with one fault, all that its judge needs.

    Attributes:
        planned: the fault.
        from_s, until_s: when it was there; None if it never began.
        evidence: the watcher's.
        controls: the follower's own record, for when it decided what.
        truth: for the distance to the target.
        limits: of the envelope.
        alone: no other fault was in the flight, and this one was as the catalogue has it.
        realtime: setpoints leave some time after their step, and not always the same.
        error: an uncaught error, "" if there was none.
    """

    planned: PlannedFault
    from_s: float | None
    until_s: float
    evidence: FlightEvidence
    controls: Sequence[ControlRecord]
    truth: Sequence[TruthSample]
    limits: EnvelopeSettings
    alone: bool = True
    error: str = ""
    realtime: bool = False


def judge(case: FaultCase) -> FaultVerdict:
    """Return what came of it."""
    last = case.controls[-1] if case.controls else None
    end = "" if last is None else f"{last.state} ({last.reason})"
    figures = _figures(case)
    failures = tuple(_failures(case, figures))
    must = case.planned.fault.must if case.alone else ""
    return FaultVerdict(str(case.planned), must, failures, figures, end)


def _failures(case: FaultCase, figures: FaultMetrics) -> Iterator[str]:
    if case.error:
        yield f"an uncaught error: {case.error}"
    yield from _always(case)
    if case.from_s is None:
        yield "the fault never began: the flight did not come so far"
        return
    if case.alone:
        yield from too_late(case.planned.fault, figures)
        yield from _OUTCOMES[case.planned.fault.outcome](case, case.from_s, figures)


def _always(case: FaultCase) -> Iterator[str]:
    """Yield what is against the rules that hold for every fault."""
    setpoints = case.evidence.setpoints
    unsure_s = case.limits.max_interval_s if case.realtime else STEP_S
    yield from envelope_failures(setpoints, case.limits, unsure_s)
    yield from pilot_failures(case.evidence)
    yield from age_failures(setpoints, case.controls)
    yield from input_failures(case.controls, setpoints)
    yield from _place_failures(case)
    last = case.evidence.motion[-1]
    if last.obeys and last.speed_m_s > STANDING_M_S:
        yield f"it flies on at {last.speed_m_s:.1f} m/s at the end, with nobody in control"


def _place_failures(case: FaultCase) -> Iterator[str]:
    limits = case.limits
    nearest = min((sample.range_m for sample in case.truth), default=math.inf)
    if limits.min_distance_m is not None and nearest < limits.min_distance_m - _NEARER_M:
        yield f"it comes as near as {nearest:.1f} m to the target"
    flown = [m for m in case.evidence.motion if m.obeys and m.armed]
    heights = [-m.position_m[2] for m in flown]
    if limits.ceiling_m is not None and max(heights, default=0.0) > limits.ceiling_m + _HEIGHT_M:
        yield f"it climbs to {max(heights):.1f} m"
    home = complex(*case.evidence.motion[0].position_m[:2])
    places = [complex(*m.position_m[:2]) - home for m in flown]
    away = max(map(abs, places), default=0.0)
    if limits.fence_radius_m is not None and away > limits.fence_radius_m + _FENCE_M:
        yield f"it flies {away:.0f} m away"
    if limits.fence_m is not None:
        outside = max(map(Fence(limits.fence_m).outside_m, places), default=0.0)
        if outside > _FENCE_M:
            yield f"it flies {outside:.0f} m out of the fence"


def too_late(fault: Fault, figures: FaultMetrics, late_s: float = 0.0) -> Iterator[str]:
    """Yield which of a fault's limits were exceeded, those of time by more than `late_s`."""
    limits = (
        ("a hold on the wire", figures.hold_s, fault.hold_within_s, "s"),
        ("standing still", figures.rest_s, fault.rest_within_s, "s"),
        ("the excursion", figures.excursion_m, fault.excursion_m, "m"),
    )
    for what, value, most, unit in limits:
        if most is not None and value is None:
            yield f"{what}: never"
        elif most is not None and value is not None and value > most + late_s * (unit == "s"):
            yield f"{what}: {value:.2f} {unit}, more than {most:.2f}"
    if figures.wire_s is not None and figures.wire_s > WIRE_WITHIN_S:
        yield f"the hold was on the wire {1e3 * figures.wire_s:.0f} ms after its decision"


def _follows_on(case: FaultCase, from_s: float, figures: FaultMetrics) -> Iterator[str]:
    fault = case.planned.fault
    until_s = min(case.until_s, case.controls[-1].time_s)
    during = [c for c in case.controls if from_s <= c.time_s <= until_s]
    held = [c for c in during if not c.state.steers]
    if held and fault.back_within_s is None:
        yield f"{held[0].time_s - from_s:.2f} s on: {held[0].state} ({held[0].reason})"
    yield from _back(figures, fault.back_within_s or 0.5)


def _follows_again(case: FaultCase, _from_s: float, figures: FaultMetrics) -> Iterator[str]:
    lost = [m for m in left_mode(case.evidence.motion) if m < case.until_s + 1.0]
    if lost and any(left_s > _from_s for left_s in lost):
        return  # the autopilot's own failsafe was faster; the pilot's rules hold
    yield from _back(figures, case.planned.fault.back_within_s or 3.0)


def _back(figures: FaultMetrics, within_s: float) -> Iterator[str]:
    if figures.back_s is None:
        yield "it does not follow again"
    elif figures.back_s > within_s:
        yield f"it follows again after {figures.back_s:.2f} s, not within {within_s:.2f} s"


def _released(case: FaultCase, from_s: float, _figures: FaultMetrics) -> Iterator[str]:
    later = [c for c in case.controls if c.time_s > from_s]
    released = [number for number, c in enumerate(later) if c.state is SupervisorState.RELEASED]
    asked = any(a.kind is FaultKind.STOP_REQUESTED for a in case.planned.fault.actions)
    if not released or (later[released[0]].reason is SupervisorReason.STOP_REQUESTED and not asked):
        yield "it is never released"
    elif any(c.state is not SupervisorState.RELEASED for c in later[released[0] :]):
        yield "it does not stay released"


def _pilot_in_control(case: FaultCase, from_s: float, figures: FaultMetrics) -> Iterator[str]:
    yield from _released(case, from_s, figures)
    if figures.after_pilot_s is None:
        yield "the autopilot stayed in the mode that flies setpoints"


def _never_follows(case: FaultCase, _from_s: float, _figures: FaultMetrics) -> Iterator[str]:
    if any(c.state.engaged for c in case.controls):
        yield "it follows"
    if any(not s.is_zero for s in case.evidence.setpoints):
        yield "something else than zero is sent"


def _released_in_mode(case: FaultCase, from_s: float, figures: FaultMetrics) -> Iterator[str]:
    yield from _released(case, from_s, figures)
    fault = case.planned.fault
    wanted = fault.ends_in[case.evidence.flavour]
    mode = next((m.mode for m in case.evidence.motion if m.time_s >= case.until_s), "no mode")
    if mode != wanted:
        yield f"{case.until_s - from_s:.0f} s on it is in {mode}, not in {wanted}"
    last_s = max((s.time_s for s in case.evidence.setpoints), default=from_s) - from_s
    if fault.silent_within_s is not None and last_s > fault.silent_within_s:
        yield f"a setpoint {last_s:.1f} s on, not within {fault.silent_within_s:.1f} s"
    if fault.silent_within_s is None and last_s < case.until_s - from_s:
        yield f"the last setpoint came {last_s:.1f} s on"


_OUTCOMES = {
    ExpectedOutcome.FOLLOWS_ON: _follows_on,
    ExpectedOutcome.FOLLOWS_AGAIN: _follows_again,
    ExpectedOutcome.RELEASED: _released,
    ExpectedOutcome.PILOT_IN_CONTROL: _pilot_in_control,
    ExpectedOutcome.NEVER_FOLLOWS: _never_follows,
    ExpectedOutcome.RELEASED_IN_MODE: _released_in_mode,
}


def _figures(case: FaultCase) -> FaultMetrics:
    setpoints = case.evidence.setpoints
    if case.from_s is None:
        return FaultMetrics(setpoints=len(setpoints))
    hold = _first_hold(case.controls, case.from_s, case.until_s)
    sent = None if hold is None else _first_at(setpoints, hold.time_s)
    stops = case.planned.fault.rest_within_s is not None
    rest_s = standing_from(case.evidence.motion, case.from_s) if stops else None
    return FaultMetrics(
        hold_s=None if sent is None else sent.time_s - case.from_s,
        wire_s=None if sent is None or hold is None or not hold.sent else sent.time_s - hold.time_s,
        rest_s=None if rest_s is None else rest_s - case.from_s,
        excursion_m=None
        if rest_s is None
        else excursion(case.evidence.motion, case.from_s, rest_s),
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


_HOLDS = (SupervisorState.SEARCHING, SupervisorState.HOLDING, SupervisorState.RELEASED)


def _first_at(setpoints: Sequence[WireSetpoint], time_s: float) -> WireSetpoint | None:
    return next((s for s in setpoints if s.time_s >= time_s - 1e-6), None)


def judge_seen(
    fault: Fault, evidence: FlightEvidence, from_s: float, late_s: float = 0.0
) -> FaultVerdict:
    """Return what came of a fault, by what shows without the follower's own record.

    Args:
        fault: in a flight with the envelope of the defaults.
        evidence: the watcher's.
        from_s: when it began, in seconds.
        late_s: so much later than promised is not too late.
    """
    stands_s = standing_from(evidence.motion, from_s)
    holds = fault.hold_within_s is not None
    figures = FaultMetrics(
        hold_s=_slower_after(evidence.setpoints, from_s) if holds else None,
        rest_s=None if stands_s is None else stands_s - from_s,
        excursion_m=None if stands_s is None else excursion(evidence.motion, from_s, stands_s),
        setpoints=len(evidence.setpoints),
    )
    limits = EnvelopeSettings()
    failures = [*envelope_failures(evidence.setpoints, limits, limits.max_interval_s)]
    failures += pilot_failures(evidence, RELEASE_WITHIN_S + late_s)
    failures += too_late(fault, figures, late_s)
    if fault.signal == signal.SIGKILL:
        failures += silence_failures(evidence, from_s, late_s)
        gone_home = any(left_s > from_s for left_s in left_mode(evidence.motion))
        stands = figures.rest_s is not None and figures.rest_s < _STOPS_ALONE_WITHIN_S + late_s
        failures += [] if gone_home or stands else ["the vehicle flies on"]
    return FaultVerdict(fault.name, fault.must, tuple(failures), figures, "")


def silence_failures(
    evidence: FlightEvidence, ended_s: float, late_s: float = 0.0
) -> Iterator[str]:
    """Yield whether a setpoint came though the follower had ended at `ended_s`, s."""
    last_s = max((s.time_s for s in evidence.setpoints), default=-math.inf) - ended_s
    if last_s > _SILENT_WITHIN_S + late_s:
        yield f"a setpoint came {last_s:.2f} s after the follower's end"


def _slower_after(setpoints: Sequence[WireSetpoint], from_s: float) -> float | None:
    """Return after how many seconds the speed sent only falls."""
    after = [s for s in setpoints if s.time_s >= from_s]
    moving = [s for s in after if s.speed_m_s > 0] or after[:1]
    last = max(moving, key=lambda s: (s.speed_m_s, s.time_s), default=None)
    return None if last is None else last.time_s - from_s


def standing_from(motion: Sequence[TrueMotion], from_s: float) -> float | None:
    """Return from when on the vehicle stands for a second, or to the end."""
    stands = ((m.time_s, m.speed_m_s <= STANDING_M_S) for m in motion if m.time_s >= from_s)
    return _lasting(stands, _STANDS_FOR_S)[0]


def _lasting(course: Iterable[tuple[float, bool]], for_s: float) -> tuple[float | None, bool]:
    """Return since when something holds, and whether it has held for so long.

    Args:
        course: time in seconds, and whether it holds then.
        for_s: the first time that it holds this long counts, else the last one, to the end.
    """
    since: float | None = None
    for time_s, holds in course:
        since = (time_s if since is None else since) if holds else None
        if since is not None and time_s - since >= for_s:
            return since, True
    return since, False


def excursion(motion: Sequence[TrueMotion], from_s: float, until_s: float) -> float:
    """Return how far in metres the vehicle went from its place at `from_s` in this time."""
    places = [m.position_m for m in motion if from_s <= m.time_s <= until_s]
    return max((math.dist(places[0], place) for place in places), default=0.0)


def _back_after(case: FaultCase) -> float | None:
    """Return how long after the fault's end the target is followed for some time."""
    later = (c for c in case.controls if c.time_s >= case.until_s)
    follows = ((c.time_s, c.state is SupervisorState.FOLLOWING) for c in later)
    since, lasts = _lasting(follows, _FOLLOWS_FOR_S)
    return since - case.until_s if since is not None and lasts else None


def _after_pilot(evidence: FlightEvidence, from_s: float) -> float | None:
    """Return how long setpoints went on after the first heartbeat with another mode, s."""
    left_s = next((t for t in left_mode(evidence.motion) if t >= from_s), None)
    if left_s is None:
        return None
    known_s = leaving_known_s(evidence, left_s)
    late = [s.time_s - known_s for s in evidence.setpoints if s.time_s > known_s and not s.is_zero]
    return max(late, default=0.0)
