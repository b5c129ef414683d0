"""The table of messages: what a flight's log holds, under which name, how often.

Everything else is derived from this table and from the dataclasses that it names: the channels and
JSON schemas of `flight.mcap`, writing and reading, and the tables of docs/reference/flight-log.md.
"""

from dataclasses import dataclass, fields
from typing import Any

from follower.flight.log import (
    ControlRecord,
    DetectionRecord,
    Event,
    ObservationRecord,
    SelectionRecord,
    TrackRecord,
)
from follower.flight.supervision.inputs import SupervisorInputs
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.links.vehicle_health import VehicleHealth
from follower.settings.live import SettingChange
from follower_control.target.estimate import TargetEstimate
from follower_control.vehicle.gimbal import GimbalRates
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_control.vehicle.state import Attitude, VehicleState
from follower_sim.kinematics import TruthSample


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame that vision took.

    Attributes:
        sequence: the source's number of the frame; a gap means frames that vision did not take.
        captured_s: when it was exposed.
        received_s: when vision took it.
        width: of the image.
        height: of the image.
        video_index: which picture of video.mkv it is, counted from 0; none if it was left out.
    """

    sequence: int
    captured_s: float
    received_s: float
    width: int
    height: int
    video_index: int | None = None


@dataclass(frozen=True, slots=True)
class SetpointRecord:
    """What was asked of the vehicle.

    Attributes:
        asked: by the servo.
        allowed: by the envelope.
        limits: what made the difference.
        sent: whether `allowed` went to the autopilot.
    """

    asked: VelocitySetpoint
    allowed: VelocitySetpoint
    limits: tuple[str, ...]
    sent: bool


@dataclass(frozen=True, slots=True)
class StepRecord:
    """The end of a control step: all that belongs to it has been written before it.

    Attributes:
        time_s: when the step ran.
        late_s: how far behind its schedule it began.
        busy_s: how long it took by the computer's own clock.
        state: the supervisor's decision.
        reason: and why.
        track_sequence: frame number of the newest track; none before the first.
        track_captured_s: and that frame's capture time.
        changes: the settings that were changed in flight from this step on.
    """

    time_s: float
    late_s: float
    busy_s: float
    state: SupervisorState
    reason: SupervisorReason
    track_sequence: int | None = None
    track_captured_s: float | None = None
    changes: tuple[SettingChange, ...] = ()


@dataclass(frozen=True, slots=True)
class MessageKind:
    """One kind of message.

    Attributes:
        topic: the channel's name.
        record: the dataclass of its content.
        rate: how often it comes.
        says: what it is.
        schema: the schema's name in a log, where it is not the dataclass's name. The format keeps
            its names when a class is renamed.
    """

    topic: str
    record: type
    rate: str
    says: str
    schema: str = ""


MESSAGES = (
    MessageKind(
        "/camera/frame",
        FrameRecord,
        "each frame that vision takes",
        "Number and times of a frame, and which picture of video.mkv it is.",
    ),
    MessageKind(
        "/vision/selection",
        SelectionRecord,
        "each choice of a target",
        "The box by which a target was chosen, none if it was given up; the frame's track follows.",
        schema="Selection",
    ),
    MessageKind(
        "/vision/detections",
        DetectionRecord,
        "each answer of a detector that answers in its own time",
        "What a detector in the background, or another node, saw; the frame's track follows.",
    ),
    MessageKind(
        "/vision/track",
        TrackRecord,
        "each frame that vision takes",
        "Vision's answer for a frame, and how long it took.",
    ),
    MessageKind(
        "/vehicle/attitude",
        Attitude,
        "telemetry, up to 100 Hz",
        "An attitude, written by the control step that took it in.",
    ),
    MessageKind(
        "/control/sighting",
        ObservationRecord,
        "each new track that sees the target",
        "Direction and size of the target in the level frame, and whether the filter took it.",
        schema="Observation",
    ),
    MessageKind(
        "/vehicle/state",
        VehicleState,
        "control rate, 50 Hz",
        "The vehicle as a control step knew it.",
    ),
    MessageKind(
        "/vehicle/health",
        VehicleHealth,
        "telemetry, about 3 Hz",
        "What the vehicle reported of its health, written when it changes.",
    ),
    MessageKind(
        "/control/situation",
        SupervisorInputs,
        "control rate, 50 Hz",
        "All that the supervisor's decision depends on: ages, permissions, requests.",
        schema="Situation",
    ),
    MessageKind(
        "/control/estimate",
        TargetEstimate,
        "control rate, 50 Hz, while there is one",
        "The target as predicted to the control step.",
    ),
    MessageKind(
        "/control/gimbal",
        GimbalRates,
        "control rate, 50 Hz, with a gimbal",
        "How fast the gimbal is to turn its camera.",
    ),
    MessageKind(
        "/control/setpoint",
        SetpointRecord,
        "control rate, 50 Hz",
        "The velocity setpoint: as asked, as allowed, whether it was sent.",
    ),
    MessageKind(
        "/control/step",
        StepRecord,
        "control rate, 50 Hz",
        "The control step itself: state, reason, times, the newest track. Its last message.",
    ),
    MessageKind(
        "/events",
        Event,
        "as they happen",
        "Changes of state, the autopilot's texts, the recorder's own troubles.",
    ),
    MessageKind(
        "/simulation/truth",
        TruthSample,
        "control rate, 50 Hz, in simulated flights alone",
        "Where vehicle and target really were. Nothing but score and report reads it.",
    ),
)

BY_TOPIC = {message.topic: message for message in MESSAGES}


def messages_of(record: object) -> list[object]:
    """Return the messages that a record is written as: a control step in parts, others whole."""
    if not isinstance(record, ControlRecord):
        return [record]
    told = record.situation, record.estimate, record.gimbal
    parts = (*record.attitudes, record.health, record.vehicle, *told)
    return [
        *(part for part in parts if part is not None),
        SetpointRecord(**shared_fields(record, SetpointRecord)),
        StepRecord(**shared_fields(record, StepRecord)),
    ]


def shared_fields(record: object, kind: type[SetpointRecord | StepRecord]) -> dict[str, Any]:
    """Return the fields of `kind`, taken from a record that has them too."""
    return {field.name: getattr(record, field.name) for field in fields(kind)}
