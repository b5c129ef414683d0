"""The rules for every setpoint on the wire, whatever the fault."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorState
from follower.simulation.faults.wire_tap import FlightEvidence, TrueMotion, WireSetpoint
from follower_control.envelope.settings import EnvelopeSettings

BODY_FRAME, VELOCITY_AND_YAW_RATE = 8, 0x5C7
RELEASE_WITHIN_S = 0.1
OLDEST_S = 0.25
_SLACK = 1e-3
_FLOAT32 = 1e-4
_BRAKES_S = 0.5
_GROWN_M_S = 0.05


def envelope_failures(
    setpoints: Sequence[WireSetpoint], limits: EnvelopeSettings, unsure_s: float = 0.02
) -> Iterator[str]:
    """Yield where a setpoint lies outside the limits, or changes faster than they allow.

    Args:
        setpoints: forward, right, down (m/s) and yaw rate (rad/s), with their times (s).
        limits: the envelope's.
        unsure_s: how much longer than between their arrivals the time between two may have been, s.
    """
    for before, after in zip((None, *setpoints), setpoints, strict=False):
        fault = envelope_failure(after, limits)
        if before is not None:
            fault = fault or jump_failure(before, after, limits, unsure_s)
        if fault:
            yield f"{after.time_s:.2f} s: {fault}"
            return


def envelope_failure(setpoint: WireSetpoint, limits: EnvelopeSettings) -> str:
    """Say how a setpoint lies outside the limits; "" if it does not."""
    forward, right, down, yaw_rate = setpoint.values
    if not all(map(math.isfinite, setpoint.values)):
        return "a setpoint is not finite"
    if (setpoint.frame, setpoint.mask) != (BODY_FRAME, VELOCITY_AND_YAW_RATE):
        return f"frame {setpoint.frame}, mask {setpoint.mask:#x} are not flown by both autopilots"
    speed = math.hypot(forward, right)
    within = (
        speed <= limits.max_speed_m_s + _SLACK
        and -limits.max_climb_m_s - _SLACK <= down <= limits.max_descent_m_s + _SLACK
        and abs(yaw_rate) <= math.radians(limits.max_yaw_rate_deg_s) + _SLACK
    )
    return "" if within else f"the setpoint {setpoint.values} is outside the envelope"


def jump_failure(
    before: WireSetpoint, after: WireSetpoint, limits: EnvelopeSettings, unsure_s: float = 0.02
) -> str:
    """Say how one setpoint differs too much from the last; "" if it does not.

    A zero may come at any time: nothing is safer. And the first one after a zero may be the
    vehicle's own velocity, with which following begins.
    """
    if after.is_zero or before.is_zero:
        return ""
    interval_s = min(after.time_s - before.time_s + unsure_s, limits.max_interval_s)
    most = limits.max_acceleration_m_s2 * interval_s + 0.02
    level = math.dist(before.values[:2], after.values[:2])
    upright = abs(before.values[2] - after.values[2])
    if max(level, upright) > most:
        return f"the velocity changes by {max(level, upright):.2f} m/s within {interval_s:.3f} s"
    turn_deg_s = math.degrees(abs(before.values[3] - after.values[3]))
    if turn_deg_s > limits.max_yaw_acceleration_deg_s2 * interval_s + 1.0:
        return f"the yaw rate changes by {turn_deg_s:.1f} deg/s within {interval_s:.3f} s"
    return ""


def pilot_failures(evidence: FlightEvidence, within_s: float = RELEASE_WITHIN_S) -> Iterator[str]:
    """Yield where setpoints went on after the pilot, or the autopilot, had taken another mode.

    Zeros are allowed while the newest heartbeat has the follower's mode, anything else is not:
    `within_s` seconds after the first heartbeat that says so.
    """
    for left_s in left_mode(evidence.motion):
        known_s = leaving_known_s(evidence, left_s)
        for setpoint in evidence.setpoints:
            if setpoint.time_s <= known_s + within_s:
                continue
            if not setpoint.is_zero:
                yield f"{setpoint.time_s:.2f} s: a velocity after the mode was left"
                return
            if not _setpoint_mode_known(evidence, setpoint.time_s, within_s):
                yield f"{setpoint.time_s:.2f} s: a setpoint in another mode"
                return


def left_mode(motion: Sequence[TrueMotion]) -> list[float]:
    """Return the times, s, at which the autopilot left the mode that flies setpoints."""
    return [after.time_s for before, after in pairwise(motion) if before.obeys and not after.obeys]


def leaving_known_s(evidence: FlightEvidence, left_s: float) -> float:
    """Return when a heartbeat first reported that the mode was left, s; infinity if none did."""
    return next((t for t, obeys in evidence.mode_heartbeats if t >= left_s and not obeys), math.inf)


def _setpoint_mode_known(
    evidence: FlightEvidence, time_s: float, within_s: float = RELEASE_WITHIN_S
) -> bool:
    """Whether the newest heartbeat, or that of 0.1 s ago, has the mode that flies setpoints."""
    known = [(t, obeys) for t, obeys in evidence.mode_heartbeats if t <= time_s]
    before = [obeys for t, obeys in known if t <= time_s - within_s]
    return bool(known) and (known[-1][1] or before[-1:] == [True])


def heartbeat_failures(evidence: FlightEvidence) -> Iterator[str]:
    """Yield where a velocity was sent although heartbeats had said for 0.1 s that it is not obeyed.

    For an autopilot of which only the wire is known; see `pilot_failures`.
    """
    for setpoint in evidence.setpoints:
        if not setpoint.is_zero and not _setpoint_mode_known(evidence, setpoint.time_s):
            yield f"{setpoint.time_s:.2f} s: a velocity in another mode"
            return


def age_failures(
    setpoints: Sequence[WireSetpoint], controls: Sequence[ControlRecord]
) -> Iterator[str]:
    """Yield where a velocity went out that the control loop had not asked for just before."""
    start = 0
    for setpoint in setpoints:
        while start < len(controls) and controls[start].time_s < setpoint.time_s - OLDEST_S:
            start += 1
        recent = (c for c in controls[start:] if c.time_s <= setpoint.time_s + _SLACK)
        if not setpoint.is_zero and not any(_same(setpoint, record) for record in recent):
            yield f"{setpoint.time_s:.2f} s: a velocity older than {OLDEST_S} s"
            return


def _same(setpoint: WireSetpoint, record: ControlRecord) -> bool:
    pairs = zip(setpoint.values, record.allowed.values, strict=True)
    return all(abs(a - b) < _FLOAT32 for a, b in pairs)


def input_failures(
    controls: Sequence[ControlRecord], setpoints: Sequence[WireSetpoint]
) -> Iterator[str]:
    """Yield where a vehicle that is held was steered on.

    From 0.5 s after a hold's begin on, when the limit on jerk has ended what it was speeding up by,
    the speed on the wire may not grow, and from 5 s on it is zero.
    """
    for began_s, ended_s in _unsteered(controls):
        slowest = math.inf
        for setpoint in setpoints:
            if not began_s + _BRAKES_S < setpoint.time_s < ended_s:
                continue
            if setpoint.speed_m_s > slowest + _GROWN_M_S:
                yield (
                    f"{setpoint.time_s:.2f} s: {setpoint.speed_m_s:.2f} m/s after a hold that was "
                    f"at {slowest:.2f} m/s"
                )
                return
            slowest = min(slowest, setpoint.speed_m_s)
            if setpoint.time_s > began_s + 5.0 and setpoint.speed_m_s > 0.05:
                yield f"{setpoint.time_s:.2f} s: still {setpoint.speed_m_s:.2f} m/s after a hold"
                return


def _unsteered(controls: Sequence[ControlRecord]) -> Iterator[tuple[float, float]]:
    """Yield the spans in which the vehicle is held: (from, to)."""
    began_s: float | None = None
    for record in controls:
        held = record.state in (SupervisorState.HOLDING, SupervisorState.RELEASED)
        if held and began_s is None:
            began_s = record.time_s
        elif not held and began_s is not None:
            yield began_s, record.time_s
            began_s = None
    if began_s is not None:
        yield began_s, math.inf
