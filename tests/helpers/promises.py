"""The supervisor's promises: every rig's flights are held to the same ones.

A rig shows its evidence: what reached the autopilot, and how the vehicle moved. Sentences and
limits are those of `follower faults`; `late_s` tells by how much a computer may be too late.
"""

from collections.abc import Callable

from waiting import until

from follower.simulation.faults.fault import fault_named
from follower.simulation.faults.judge import (
    STANDING_M_S,
    judge_seen,
    silence_failures,
    standing_from,
)
from follower.simulation.faults.setpoint_rules import left_mode
from follower.simulation.faults.wire_tap import FlightEvidence, WireSetpoint

Look = Callable[[], FlightEvidence]
LateS = Callable[[], float]
_WATCHED_S = 1.0


def assert_keeps(look: Look, fault: str, from_s: float, late_s: LateS) -> None:
    """What a fault of the catalogue wants holds of a flight in which it began at `from_s`.

    All that was sent was finite, within the envelope and not against the pilot's mode, too; and it
    flew by setpoints before. It is waited until the vehicle stands, or somebody else has it.
    """
    until(lambda: _is_over(look(), from_s, late_s() + _WATCHED_S))
    evidence = look()
    assert any(is_moving(s) for s in evidence.setpoints if s.time_s < from_s)
    assert judge_seen(fault_named(fault), evidence, from_s, late_s()).failures == ()


def is_moving(setpoint: WireSetpoint) -> bool:
    return not setpoint.is_zero


def _is_over(evidence: FlightEvidence, from_s: float, for_s: float) -> bool:
    stands_s = standing_from(evidence.motion, from_s)
    ends_s = [t for t in left_mode(evidence.motion) if t > from_s]
    ends_s += [] if stands_s is None else [stands_s]
    return any(evidence.motion[-1].time_s - end_s > for_s for end_s in ends_s)


def assert_releases(look: Look, fault: str, from_s: float, late_s: LateS, ended_s: float) -> None:
    """It is kept; zero was sent until the vehicle stood, and nothing once it ended at `ended_s`."""
    assert_keeps(look, fault, from_s, late_s)
    until(lambda: look().motion[-1].time_s > ended_s + late_s() + _WATCHED_S)
    evidence = look()
    last = evidence.setpoints[-1]
    assert last.is_zero
    assert next(m for m in evidence.motion if m.time_s >= last.time_s).speed_m_s < STANDING_M_S
    assert list(silence_failures(evidence, ended_s, late_s())) == []
