"""A recorded flight, as its folder gives it back."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from follower.flight.log import (
    ControlRecord,
    DetectionRecord,
    Event,
    FlightLog,
    ObservationRecord,
    SelectionRecord,
    TrackRecord,
)
from follower.flight.supervision.inputs import SupervisorInputs
from follower.links.vehicle_health import VehicleHealth
from follower.recording.config import FlightConfig
from follower.recording.mcap_writer import FlightFileError, LogContent, read_log
from follower.recording.messages import FrameRecord, SetpointRecord, StepRecord, shared_fields
from follower.recording.recorder import CONFIG, LOG, TLOG
from follower.recording.tlog import TlogPacket, read_tlog
from follower.recording.video_reader import read_pictures
from follower.recording.video_writer import VIDEO
from follower_control.target.estimate import TargetEstimate, azimuth_of
from follower_control.vehicle.gimbal import GimbalRates
from follower_control.vehicle.state import Attitude, VehicleState
from follower_sim.kinematics import TruthSample
from follower_vision.images.frame import Frame

Table: TypeAlias = npt.NDArray[np.void]

_NAN = math.nan
_SETPOINT = ("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s")


def arrays(log: FlightLog) -> dict[str, Table]:
    """Return "tracks", "controls" and "events", a row a record; `pandas.DataFrame` takes each.

    A number that is not known is NaN, a text "". Times are seconds on the flight's clock.
    "controls" has the setpoints in the heading frame, the estimate's direction (from north, or
    from the nose without telemetry; up is positive) and log of the angular size, and telemetry in
    north, east, down.
    """
    return {
        "tracks": _table([_track_row(one) for one in log.tracks], _TRACK),
        "controls": _table([_control_row(one) for one in log.controls], _CONTROL),
        "events": _table([(one.time_s, one.source, one.text) for one in log.events], _EVENT),
    }


_TRACK = {
    **dict.fromkeys(("sequence",), np.int64),
    **dict.fromkeys(("captured_s", "received_s", "done_s", "busy_s"), np.float64),
    **dict.fromkeys(("cx_px", "cy_px", "width_px", "height_px", "confidence"), np.float64),
    **dict.fromkeys(("state", "produced_by"), str),
}
_CONTROL = {
    **dict.fromkeys(("time_s", "late_s", "busy_s", "track_captured_s"), np.float64),
    **dict.fromkeys((f"asked_{name}" for name in _SETPOINT), np.float64),
    **dict.fromkeys((f"allowed_{name}" for name in _SETPOINT), np.float64),
    **dict.fromkeys(("azimuth_rad", "elevation_rad", "log_scale"), np.float64),
    **dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad"), np.float64),
    **dict.fromkeys(("north_m", "east_m", "down_m"), np.float64),
    **dict.fromkeys((f"velocity_{name}_m_s" for name in ("north", "east", "down")), np.float64),
    **dict.fromkeys(("state", "reason", "limits", "mode"), str),
    **dict.fromkeys(("sent", "armed"), np.bool_),
}
_EVENT = {"time_s": np.float64, "source": str, "text": str}


def _table(rows: Sequence[tuple[Any, ...]], columns: Mapping[str, Any]) -> Table:
    """Return rows as a structured array; a column of text is as wide as its longest."""
    kinds = [
        (name, f"U{max((len(row[place]) for row in rows), default=1) or 1}")
        if kind is str
        else (name, kind)
        for place, (name, kind) in enumerate(columns.items())
    ]
    return np.array(rows, dtype=kinds)


def _track_row(record: TrackRecord) -> tuple[Any, ...]:
    times = (record.captured_s, record.received_s, record.done_s, record.busy_s)
    track = record.track
    if track is None:
        return (record.sequence, *times, *(_NAN,) * 5, "", "")
    box = (track.box.cx, track.box.cy, track.box.width, track.box.height)
    said = (track.confidence, str(track.state), track.produced_by)
    return (record.sequence, *times, *box, *said)


def _control_row(record: ControlRecord) -> tuple[Any, ...]:
    captured_s = _NAN if record.track_captured_s is None else record.track_captured_s
    return (
        *(record.time_s, record.late_s, record.busy_s, captured_s),
        *record.asked.values,
        *record.allowed.values,
        *_direction(record.estimate),
        *_motion(record.vehicle),
        *(str(record.state), str(record.reason), "|".join(record.limits), record.vehicle.mode),
        *(record.sent, record.vehicle.armed),
    )


def _direction(estimate: TargetEstimate | None) -> tuple[float, ...]:
    if estimate is None:
        return (_NAN,) * 3
    return azimuth_of(estimate), estimate.height_angle_rad, estimate.log_scale


def _motion(vehicle: VehicleState) -> tuple[float, ...]:
    """Return roll, pitch and yaw, then position and velocity north, east, down."""
    unknown = (_NAN,) * 6
    attitude = unknown if vehicle.attitude is None else vehicle.attitude.numbers
    position = unknown if vehicle.position is None else vehicle.position.numbers
    return *attitude[:3], *position


_PARTS = {
    VehicleState: "vehicle",
    SupervisorInputs: "situation",
    TargetEstimate: "estimate",
    VehicleHealth: "health",
    GimbalRates: "gimbal",
}
"""The messages of a control step that are one field of its record each."""


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
        detections: what a detector in the background, or another node, saw.
        whole: the log was closed; False where it is cut off, as by a power cut.

    Examples:
        >>> import follower
        >>> flight = follower.open_flight("runs/demo")
        >>> controls = flight.arrays()["controls"]  # pandas.DataFrame(controls) works too
        >>> following = controls[controls["state"] == "following"]
        >>> print(following["allowed_forward_m_s"].max() > 0.5)
        True
    """

    folder: Path
    config: FlightConfig
    log: FlightLog = field(default_factory=FlightLog)
    frames: list[FrameRecord] = field(default_factory=list)
    selections: list[SelectionRecord] = field(default_factory=list)
    observations: list[ObservationRecord] = field(default_factory=list)
    truth: list[TruthSample] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    detections: list[DetectionRecord] = field(default_factory=list)
    whole: bool = True
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

    def arrays(self) -> dict[str, Table]:
        """Return the log as NumPy structured arrays "tracks", "controls" and "events".

        The unit stands in a column's name; times are seconds on the flight's clock; unknown is NaN
        or "". `pandas.DataFrame` takes each of them.
        """
        return arrays(self.log)

    def packets(self) -> Iterator[TlogPacket]:
        """Return the MAVLink packets, none if they were not recorded; damage becomes a remark."""
        path = self.folder / TLOG
        try:
            if path.exists():
                yield from read_tlog(path, self.config.epoch_ns, self.remarks)
        except OSError as error:
            said = f"{TLOG} cannot be read: {error.strerror}."
            self.remarks += [] if said in self.remarks else [said]


def check_not_of(flight: RecordedFlight, out: Path) -> None:
    """Refuse a file to be written that is one of a flight's own.

    Raises:
        FileExistsError: it is.
    """
    own = flight.folder.resolve()
    if out.resolve() in [own / name for name in (LOG, TLOG, CONFIG, VIDEO)]:
        raise FileExistsError(f"{out} belongs to the recording: name another file")


def open_flight(folder: str | Path) -> RecordedFlight:
    """Open a flight's folder.

    Raises:
        FlightFileError: it is none, or its log cannot be read; the message says what could be.

    Examples:
        >>> import follower
        >>> flight = follower.open_flight("runs/demo")
        >>> print(flight.config.kind, len(flight.log.tracks) > 100, flight.remarks)
        simulated True []
        >>> for frame in flight.pictures():
        ...     image = frame.image
    """
    path = Path(folder)
    if path.name == LOG and path.is_file():
        path = path.parent
    if not (path / LOG).is_file():
        raise FlightFileError(_no_flight(path))
    content = read_log(path / LOG)
    flight = RecordedFlight(path, _config(path, content), remarks=content.remarks)
    flight.whole, flight._messages = content.whole, content.messages
    _sort(flight, content.messages)
    return flight


def _no_flight(path: Path) -> str:
    if not path.is_dir():
        what = "this is a file" if path.exists() else "there is no such folder"
        return f"{path}: {what}; a flight is a folder with {LOG} in it"
    others = [name for name in (CONFIG, TLOG, VIDEO) if (path / name).is_file()]
    there = f"only {', '.join(others)}" if others else "nothing else of a flight either"
    return f"{path}: no flight, {LOG} is missing; there is {there}"


def _config(folder: Path, content: LogContent) -> FlightConfig:
    """Read the log's copy of the configuration, or the file where that is damaged."""
    path = folder / CONFIG
    config: FlightConfig | None = None
    try:
        text = path.read_text("utf-8")
        config = FlightConfig.from_yaml(text)
        trouble = "" if text == content.config_yaml else "not as it was recorded"
    except FileNotFoundError:
        trouble = "missing"
    except OSError as error:
        trouble = error.strerror or str(error)
    except ValueError as error:
        trouble = str(error)
    try:
        recorded = FlightConfig.from_yaml(content.config_yaml)
    except ValueError as error:
        if config is not None:
            return config
        read = f"of {LOG} {len(content.messages)} messages could be read"
        said = f"{path}: {trouble}; its copy in {LOG} is no better; {read}"
        raise FlightFileError(said) from error
    if trouble not in ("", "missing"):
        content.remarks.append(f"{path}: {trouble}; taken is its copy in {LOG}.")
    return recorded


def _sort(flight: RecordedFlight, messages: Iterable[tuple[float, object]]) -> None:
    """Put each message where it belongs; the parts of a control step become one record."""
    parts: list[object] = []
    for _, message in messages:
        match message:
            case TrackRecord():
                flight.log.tracks.append(message)
            case Event():
                flight.log.events.append(message)
            case FrameRecord():
                flight.frames.append(message)
            case SelectionRecord():
                flight.selections.append(message)
            case ObservationRecord():
                flight.observations.append(message)
            case DetectionRecord():
                flight.detections.append(message)
            case TruthSample():
                flight.truth.append(message)
            case StepRecord():
                flight.log.controls.append(_control_record(parts, message))
                parts = []
            case _:
                parts.append(message)


def _control_record(parts: Sequence[object], step: StepRecord) -> ControlRecord:
    """Return the record of a control step from its messages, of which `step` is the last."""
    values: dict[str, Any] = {"vehicle": VehicleState(), "estimate": None}
    for part in (*parts, step):
        if type(part) in _PARTS:
            values[_PARTS[type(part)]] = part
        elif isinstance(part, SetpointRecord | StepRecord):
            values |= shared_fields(part, type(part))
    if "asked" not in values:
        raise FlightFileError(f"the control step at {step.time_s:.3f} s has no setpoint")
    attitudes = tuple(part for part in parts if isinstance(part, Attitude))
    return ControlRecord(**values, attitudes=attitudes)
