"""What happened in a flight, kept in memory for the score and the report."""

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias, TypeVar

from follower.flight.supervision.inputs import SupervisorInputs
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.links.vehicle_health import VehicleHealth
from follower.settings.live import SettingChange
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingObservation, GateVerdict
from follower_control.vehicle.gimbal import GimbalRates
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_control.vehicle.state import Attitude, VehicleState
from follower_vision.detection import Detection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.plugins import telling_failures
from follower_vision.trackers.target_tracker import TargetPrediction
from follower_vision.trackers.track import Track


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
        requests: how many selections of an operator, of a target or of none, were carried out up
            to this frame.
        prospect: where the target could be in it by what control knew; None if it was not asked.
        replaced: how often another target took the place of the one that was followed, unasked by
            an operator, as by a program's choice, up to this frame; None if it never did.
    """

    track: Track | None
    sequence: int
    captured_s: float
    received_s: float
    done_s: float
    busy_s: float
    requests: int = 0
    prospect: TargetPrediction | None = None
    replaced: int | None = None


@dataclass(frozen=True, slots=True)
class SelectionRecord:
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
class DetectionRecord:
    """What a detector that answers in its own time saw, as vision took it in.

    Attributes:
        sequence: the number of the frame whose track uses it.
        captured_s: when that frame was exposed.
        index: which frame it was shown, counted from 0 for the one in which the target was chosen.
        detections: what it saw there, the best first.
    """

    sequence: int
    captured_s: float
    index: int
    detections: tuple[Detection, ...]


@dataclass(frozen=True, slots=True)
class ObservationRecord:
    """What control made of a track that sees the target.

    Attributes:
        time_s: when the control step ran.
        sighting: the target's direction and size.
        verdict: whether the filter took it.
    """

    time_s: float
    sighting: BearingObservation
    verdict: GateVerdict


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
        vehicle: what telemetry reported.
        asked: what the servo asked for.
        allowed: what the envelope let through.
        limits: names of the limits that changed it.
        sent: whether `allowed` went to the autopilot.
        track_sequence: frame number of that newest track.
        situation: what the decision was made from.
        attitudes: those that came since the step before.
        gimbal: how fast its gimbal is to turn, None without one.
        health: what the vehicle reported of its health since the step before, None if nothing.
        changes: the settings that were changed in flight from this step on, in their order.
    """

    time_s: float
    late_s: float
    busy_s: float
    state: SupervisorState
    reason: SupervisorReason
    estimate: TargetEstimate | None
    track_captured_s: float | None
    vehicle: VehicleState
    asked: VelocitySetpoint
    allowed: VelocitySetpoint
    limits: tuple[str, ...]
    sent: bool
    track_sequence: int | None = None
    situation: SupervisorInputs | None = None
    attitudes: tuple[Attitude, ...] = ()
    gimbal: GimbalRates | None = None
    health: VehicleHealth | None = None
    changes: tuple[SettingChange, ...] = ()


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth a line: a change of state, a command, a message of the autopilot.

    Attributes:
        time_s: when it happened, seconds on the system's clock.
        source: who says so: "supervisor", "autopilot", "autonomy", "recorder", "plug-in".
        text: what happened.
    """

    time_s: float
    source: str
    text: str


RecordT = TypeVar("RecordT")
LogRecord: TypeAlias = (
    TrackRecord | SelectionRecord | DetectionRecord | ObservationRecord | ControlRecord | Event
)


class FlightSink(Protocol):
    """Takes everything as it happens, on the thread on which it happens; never waits long."""

    def add_frame(self, frame: Frame, received_s: float) -> None:
        """Take a frame before vision works on it; `received_s` in seconds."""
        ...

    def add(self, record: LogRecord, time_s: float) -> None:
        """Take a record that was made at `time_s`, in seconds."""
        ...


@dataclass(slots=True)
class FlightLog:
    """Everything of one flight, in the order in which it happened.

    Attributes:
        tracks: vision's answers.
        controls: the control steps.
        events: what is worth a line.
        sink: takes everything too, if there is one: the recorder.
        kept: how many of the newest of each stay here at least; None keeps all.
            A recorded flight of hours would fill the memory: a control step is some 8 kB.
    """

    tracks: list[TrackRecord] = field(default_factory=list)
    controls: list[ControlRecord] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    sink: FlightSink | None = None
    kept: int | None = None

    def add_track(self, record: TrackRecord) -> None:
        """Add vision's answer for a frame."""
        self._keep(self.tracks, record)
        self.pass_on(record, record.done_s)

    def add_control(self, record: ControlRecord) -> None:
        """Add a control step."""
        self._keep(self.controls, record)
        self.pass_on(record, record.time_s)

    def note(self, time_s: float, source: str, text: str) -> None:
        """Add an event at `time_s`, in seconds."""
        event = Event(time_s, source, text)
        self._keep(self.events, event)
        self.pass_on(event, time_s)

    def pass_frame_on(self, frame: Frame, received_s: float) -> None:
        """Hand a frame that vision begins to work on to the sink; none is kept in memory."""
        if self.sink is not None:
            self.sink.add_frame(frame, received_s)

    def pass_on(self, record: LogRecord, time_s: float) -> None:
        """Hand a record to the sink, made at `time_s` in seconds."""
        if self.sink is not None:
            self.sink.add(record, time_s)

    def _keep(self, records: list[RecordT], record: RecordT) -> None:
        records.append(record)
        if self.kept is not None and len(records) > 2 * self.kept:
            del records[: -self.kept]


_PLUGIN = "plug-in"


def noting_failed_plugins(log: FlightLog, now: Callable[[], float]) -> AbstractContextManager[None]:
    """Note in the log, while entered, what parts of other packages do wrong; `now` in seconds."""
    return telling_failures(lambda text: log.note(now(), _PLUGIN, text))


def failed_plugins(log: FlightLog) -> list[str]:
    """Return what parts of other packages have done wrong in a flight, in sentences."""
    said = [event.text for event in log.events if event.source == _PLUGIN]
    return [f"{text[0].upper()}{text[1:]}" for text in said]


def setpoint_delays(controls: Sequence[ControlRecord]) -> dict[float, float]:
    """Return, for each frame that was steered by, capture time → seconds from it to the setpoint.

    That is the beginning of the first step that used the frame's track and sent what the servo
    made of it; how long the step itself takes is `ControlRecord.busy_s`.
    """
    delays: dict[float, float] = {}
    used_s: float | None = None
    for record in controls:
        captured_s = record.track_captured_s
        if captured_s is None or captured_s == used_s:
            continue
        used_s = captured_s
        if record.sent and record.state is SupervisorState.FOLLOWING:
            delays[captured_s] = record.time_s - captured_s
    return delays


class Stopwatch:
    """Runs from its making on the computer's own clock, also where the system's is simulated."""

    def __init__(self) -> None:
        self._began_s = time.perf_counter()

    def elapsed_s(self) -> float:
        """Return the seconds since the stopwatch was made."""
        return time.perf_counter() - self._began_s
