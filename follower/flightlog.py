"""What happened in a flight, kept in memory for the score and the report."""

from __future__ import annotations

from dataclasses import dataclass, field

from follower.supervisor import Reason, State
from follower_control.estimate import TargetEstimate
from follower_control.setpoint import VelocitySetpoint
from follower_control.vehicle import VehicleState
from follower_vision.track import Track


@dataclass(frozen=True, slots=True)
class TrackRecord:
    """One frame's way through vision, all times in seconds on the system's clock.

    Attributes:
        track: vision's answer, None while no target is chosen.
        sequence: the frame's number.
        captured_s: when the frame was exposed.
        received_s: when vision took it.
        done_s: when the answer was there.
        busy_s: how long vision worked on it by the computer's own clock (in lockstep the
            simulated clock stands still meanwhile).
    """

    track: Track | None
    sequence: int
    captured_s: float
    received_s: float
    done_s: float
    busy_s: float


@dataclass(frozen=True, slots=True)
class ControlRecord:
    """One step of the control loop.

    Attributes:
        time_s: when the step ran.
        late_s: how far behind its schedule it began.
        busy_s: how long it took by the computer's own clock.
        state: the supervisor's decision.
        reason: and why.
        estimate: the target as predicted to `time_s`, None if there is none.
        track_captured_s: capture time of the newest track used, None before the first.
        vehicle: what telemetry said.
        asked: what the servo wanted.
        allowed: what the envelope let through.
        limits: names of the limits that changed it.
        sent: whether `allowed` went to the autopilot.
    """

    time_s: float
    late_s: float
    busy_s: float
    state: State
    reason: Reason
    estimate: TargetEstimate | None
    track_captured_s: float | None
    vehicle: VehicleState
    asked: VelocitySetpoint
    allowed: VelocitySetpoint
    limits: tuple[str, ...]
    sent: bool


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth a line: a change of state, a command, a message of the autopilot."""

    time_s: float
    source: str
    text: str


@dataclass(slots=True)
class FlightLog:
    """Everything of one flight, in the order in which it happened."""

    tracks: list[TrackRecord] = field(default_factory=list)
    controls: list[ControlRecord] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def note(self, time_s: float, source: str, text: str) -> None:
        """Add an event."""
        self.events.append(Event(time_s, source, text))
