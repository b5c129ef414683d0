"""What happened in a flight, kept in memory for the score and the report."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from follower.links.vehicle_health import VehicleHealth
from follower.setting_change import SettingChange
from follower.situation import Situation
from follower.supervisor import Reason, State
from follower_control.estimate import TargetEstimate
from follower_control.estimator import Verdict
from follower_control.gimbal import GimbalRates
from follower_control.servo_settings import Mode
from follower_control.setpoint import VelocitySetpoint
from follower_control.sighting import Sighting
from follower_control.vehicle import Attitude, VehicleState
from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.prospect import Prospect
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
        requests: how many wishes of an operator for a target, or for none, were carried out up to
            this frame.
        prospect: where the target could be in it by what control knew; None if it was not asked.
    """

    track: Track | None
    sequence: int
    captured_s: float
    received_s: float
    done_s: float
    busy_s: float
    requests: int = 0
    prospect: Prospect | None = None


@dataclass(frozen=True, slots=True)
class Selection:
    """A target was chosen, or given up.

    Attributes:
        sequence: the number of the frame in which it was.
        captured_s: when that frame was exposed.
        box: what shows the target in it; none if there is to be no target any more.
    """

    sequence: int
    captured_s: float
    box: Box | None


@dataclass(frozen=True, slots=True)
class Observation:
    """What control made of a track that sees the target.

    Attributes:
        time_s: when the control step ran.
        sighting: the target's direction and size.
        verdict: whether the filter took it.
    """

    time_s: float
    sighting: Sighting
    verdict: Verdict


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
        track_sequence: frame number of that newest track.
        situation: what the decision was made from.
        attitudes: those that came since the step before.
        gimbal: how fast its gimbal is to turn, None without one.
        mode_asked: the way of following that was asked for at this step, None if none was.
        health: what the vehicle told of its health since the step before, None if nothing.
        changes: the settings that were changed in flight from this step on, in their order.
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
    track_sequence: int | None = None
    situation: Situation | None = None
    attitudes: tuple[Attitude, ...] = ()
    gimbal: GimbalRates | None = None
    mode_asked: Mode | None = None
    health: VehicleHealth | None = None
    changes: tuple[SettingChange, ...] = ()


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth a line: a change of state, a command, a message of the autopilot.

    Attributes:
        time_s: when it happened.
        source: who says so: "supervisor", "autopilot", "autonomy", "recorder".
        text: what happened.
    """

    time_s: float
    source: str
    text: str


class FlightSink(Protocol):
    """Is told everything as it happens, on the thread on which it happens; never waits long."""

    def add_frame(self, frame: Frame, received_s: float) -> None:
        """Take a frame before vision works on it."""
        ...

    def add_selection(self, selection: Selection, received_s: float) -> None:
        """Take a choice of a target."""
        ...

    def add_track(self, record: TrackRecord) -> None:
        """Take vision's answer."""
        ...

    def add_observation(self, observation: Observation) -> None:
        """Take what control made of a track; the step's record follows."""
        ...

    def add_control(self, record: ControlRecord) -> None:
        """Take a control step."""
        ...

    def add_event(self, event: Event) -> None:
        """Take an event."""
        ...


@dataclass(slots=True)
class FlightLog:
    """Everything of one flight, in the order in which it happened.

    Attributes:
        tracks: vision's answers.
        controls: the control steps.
        events: what is worth a line.
        sink: is told everything too, if there is one: the recorder.
        kept: how many of the newest of each stay here at least; None keeps all.
            A recorded flight of hours would fill the memory: a control step is some 8 kB.
    """

    tracks: list[TrackRecord] = field(default_factory=list)
    controls: list[ControlRecord] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    sink: FlightSink | None = None
    kept: int | None = None

    def see(self, frame: Frame, received_s: float) -> None:
        """Pass on a frame that vision begins to work on; frames are not kept in memory."""
        if self.sink is not None:
            self.sink.add_frame(frame, received_s)

    def select(self, selection: Selection, received_s: float) -> None:
        """Pass on that a target was chosen."""
        if self.sink is not None:
            self.sink.add_selection(selection, received_s)

    def add_track(self, record: TrackRecord) -> None:
        """Add vision's answer for a frame."""
        self.tracks.append(record)
        self._forget(self.tracks)
        if self.sink is not None:
            self.sink.add_track(record)

    def observe(self, observation: Observation) -> None:
        """Pass on what control made of a track."""
        if self.sink is not None:
            self.sink.add_observation(observation)

    def add_control(self, record: ControlRecord) -> None:
        """Add a control step."""
        self.controls.append(record)
        self._forget(self.controls)
        if self.sink is not None:
            self.sink.add_control(record)

    def note(self, time_s: float, source: str, text: str) -> None:
        """Add an event."""
        event = Event(time_s, source, text)
        self.events.append(event)
        self._forget(self.events)
        if self.sink is not None:
            self.sink.add_event(event)

    def _forget(self, records: list[TrackRecord] | list[ControlRecord] | list[Event]) -> None:
        if self.kept is not None and len(records) > 2 * self.kept:
            del records[: -self.kept]
