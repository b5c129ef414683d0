"""The table of messages: what a flight's log holds, under which name, how often.

Everything else is derived from this table and from the dataclasses that it names: the channels and
JSON schemas of `flight.mcap`, writing and reading, and the tables of docs/flight-log.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from follower.flightlog import Event, Observation, Selection, TrackRecord
from follower.links.vehicle_health import VehicleHealth
from follower.recorder.records import FrameRecord, SetpointRecord, StepRecord
from follower.situation import Situation
from follower_control.estimate import TargetEstimate
from follower_control.gimbal import GimbalRates
from follower_control.vehicle import Attitude, VehicleState
from follower_sim.truth_sample import TruthSample


@dataclass(frozen=True, slots=True)
class Message:
    """One kind of message.

    Attributes:
        topic: the channel's name.
        record: the dataclass of its content.
        rate: how often it comes.
        says: what it is.
    """

    topic: str
    record: type
    rate: str
    says: str


MESSAGES = (
    Message(
        "/camera/frame",
        FrameRecord,
        "each frame that vision takes",
        "Number and times of a frame, and which picture of video.mkv it is.",
    ),
    Message(
        "/vision/selection",
        Selection,
        "each choice of a target",
        "The box by which a target was chosen, none if it was given up; the frame's track follows.",
    ),
    Message(
        "/vision/track",
        TrackRecord,
        "each frame that vision takes",
        "Vision's answer for a frame, and how long it took.",
    ),
    Message(
        "/vehicle/attitude",
        Attitude,
        "telemetry, up to 100 Hz",
        "An attitude, written by the control step that took it in.",
    ),
    Message(
        "/control/sighting",
        Observation,
        "each new track that sees the target",
        "Direction and size of the target in the level frame, and whether the filter took it.",
    ),
    Message(
        "/vehicle/state",
        VehicleState,
        "control rate, 50 Hz",
        "The vehicle as a control step knew it.",
    ),
    Message(
        "/vehicle/health",
        VehicleHealth,
        "telemetry, about 3 Hz",
        "What the vehicle told of its health, written when it changes.",
    ),
    Message(
        "/control/situation",
        Situation,
        "control rate, 50 Hz",
        "All that the supervisor's decision depends on: ages, permissions, requests.",
    ),
    Message(
        "/control/estimate",
        TargetEstimate,
        "control rate, 50 Hz, while there is one",
        "The target as predicted to the control step.",
    ),
    Message(
        "/control/gimbal",
        GimbalRates,
        "control rate, 50 Hz, with a gimbal",
        "How fast the gimbal is to turn its camera.",
    ),
    Message(
        "/control/setpoint",
        SetpointRecord,
        "control rate, 50 Hz",
        "The velocity setpoint: as asked, as allowed, whether it was sent.",
    ),
    Message(
        "/control/step",
        StepRecord,
        "control rate, 50 Hz",
        "The control step itself: state, reason, times, the newest track. Its last message.",
    ),
    Message(
        "/events",
        Event,
        "as they happen",
        "Changes of state, the autopilot's words, the recorder's own troubles.",
    ),
    Message(
        "/simulation/truth",
        TruthSample,
        "control rate, 50 Hz, in simulated flights alone",
        "Where vehicle and target really were. Nothing but score and report reads it.",
    ),
)

BY_TOPIC = {message.topic: message for message in MESSAGES}
BY_RECORD = {message.record: message for message in MESSAGES}
