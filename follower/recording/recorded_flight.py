"""A recorded flight, as its folder gives it back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from follower.flightlog import (
    ControlRecord,
    Event,
    FlightLog,
    Observation,
    Selection,
    TrackRecord,
)
from follower.links.vehicle_health import VehicleHealth
from follower.recorder.config import FlightConfig
from follower.recorder.log_writer import LOG, TLOG
from follower.recorder.reading import FlightFileError, LogContent, read_log
from follower.recorder.recorder import CONFIG
from follower.recorder.records import FrameRecord, SetpointRecord, StepRecord
from follower.recorder.tlog import Packet, read_tlog
from follower.recorder.video_queue import VIDEO
from follower.recorder.video_reading import read_pictures
from follower.situation import Situation
from follower_control.estimate import TargetEstimate
from follower_control.gimbal import GimbalRates
from follower_control.vehicle import Attitude, VehicleState
from follower_sim.truth_sample import TruthSample
from follower_vision.frame import Frame


@dataclass(slots=True)
class RecordedFlight:
    """What a flight's folder holds.

    Attributes:
        folder: where it is.
        config: what was flown.
        log: tracks, control steps and events, as the flight had them in memory.
        frames: the frames that vision took.
        selections: the choices of a target.
        observations: what control made of the tracks.
        truth: the simulator's, empty for real flights.
        remarks: what is missing or damaged, in sentences.
    """

    folder: Path
    config: FlightConfig
    log: FlightLog = field(default_factory=FlightLog)
    frames: list[FrameRecord] = field(default_factory=list)
    selections: list[Selection] = field(default_factory=list)
    observations: list[Observation] = field(default_factory=list)
    truth: list[TruthSample] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    _messages: list[tuple[float, object]] = field(default_factory=list)

    def messages(self) -> Iterator[tuple[float, object]]:
        """Return (time_s, message) in the order written; a control step comes in its parts."""
        return iter(self._messages)

    def pictures(self) -> Iterator[Frame]:
        """Return the frames that are in the video, decoded, in their order.

        Raises:
            FlightFileError: there is no video, or it cannot be opened.
        """
        return read_pictures(self.folder / VIDEO, self.frames, self.remarks)

    def packets(self) -> Iterator[Packet]:
        """Return the MAVLink packets, none if they were not recorded; damage becomes a remark."""
        path = self.folder / TLOG
        return read_tlog(path, self.config.epoch_ns, self.remarks) if path.exists() else iter(())


def open_flight(folder: str | Path) -> RecordedFlight:
    """Open a flight's folder.

    Raises:
        FlightFileError: it is none, or its log cannot be read; the message says what could be.
    """
    path = Path(folder)
    if path.name == LOG and path.is_file():
        path = path.parent
    if not (path / LOG).is_file():
        raise FlightFileError(_no_flight(path))
    content = read_log(path / LOG)
    flight = RecordedFlight(path, _config(path, content), remarks=content.remarks)
    flight._messages = content.messages
    _sort(flight, content.messages)
    return flight


def _no_flight(path: Path) -> str:
    if not path.is_dir():
        return f"{path}: there is no such folder; a flight is a folder with {LOG} in it"
    others = [name for name in (CONFIG, TLOG, VIDEO) if (path / name).is_file()]
    there = f"only {', '.join(others)}" if others else "nothing else of a flight either"
    return f"{path}: no flight, {LOG} is missing; there is {there}"


def _config(folder: Path, content: LogContent) -> FlightConfig:
    """Read the configuration, or the log's copy of it where the file is missing or damaged."""
    path = folder / CONFIG
    try:
        return FlightConfig.from_yaml(path.read_text("utf-8"))
    except (FileNotFoundError, ValueError) as error:
        missing = isinstance(error, FileNotFoundError)
        trouble = f"{path}: {'missing' if missing else error}"
    try:
        config = FlightConfig.from_yaml(content.config_yaml)
    except ValueError as error:
        read = f"of {LOG} {len(content.messages)} messages could be read"
        raise FlightFileError(f"{trouble}; its copy in {LOG} is no better; {read}") from error
    if not missing:
        content.remarks.append(f"{trouble}; taken is its copy in {LOG}.")
    return config


def _sort(flight: RecordedFlight, messages: Iterable[tuple[float, object]]) -> None:
    """Put each message where it belongs; the parts of a control step become one record."""
    parts = _StepParts()
    for _, message in messages:
        match message:
            case TrackRecord():
                flight.log.tracks.append(message)
            case Event():
                flight.log.events.append(message)
            case FrameRecord():
                flight.frames.append(message)
            case Selection():
                flight.selections.append(message)
            case Observation():
                flight.observations.append(message)
            case TruthSample():
                flight.truth.append(message)
            case StepRecord():
                flight.log.controls.append(parts.record(message))
                parts = _StepParts()
            case _:
                parts.take(message)


@dataclass(slots=True)
class _StepParts:
    """The parts of a control step until its last one comes."""

    attitudes: tuple[Attitude, ...] = ()
    vehicle: VehicleState = field(default_factory=VehicleState)
    situation: Situation | None = None
    estimate: TargetEstimate | None = None
    health: VehicleHealth | None = None
    gimbal: GimbalRates | None = None
    setpoint: SetpointRecord | None = None

    def take(self, message: object) -> None:
        match message:
            case Attitude():
                self.attitudes = (*self.attitudes, message)
            case VehicleState():
                self.vehicle = message
            case Situation():
                self.situation = message
            case TargetEstimate():
                self.estimate = message
            case VehicleHealth():
                self.health = message
            case GimbalRates():
                self.gimbal = message
            case SetpointRecord():
                self.setpoint = message

    def record(self, step: StepRecord) -> ControlRecord:
        if self.setpoint is None:
            raise FlightFileError(f"the control step at {step.time_s:.3f} s has no setpoint")
        return ControlRecord(
            time_s=step.time_s,
            late_s=step.late_s,
            busy_s=step.busy_s,
            state=step.state,
            reason=step.reason,
            estimate=self.estimate,
            track_captured_s=step.track_captured_s,
            vehicle=self.vehicle,
            asked=self.setpoint.asked,
            allowed=self.setpoint.allowed,
            limits=self.setpoint.limits,
            sent=self.setpoint.sent,
            track_sequence=step.track_sequence,
            situation=self.situation,
            attitudes=self.attitudes,
            gimbal=self.gimbal,
            mode_asked=step.mode_asked,
            health=self.health,
            changes=step.changes,
        )
