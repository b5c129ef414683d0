"""A flight as files: MCAP, tlog, video, settings; writing and reading.

Uses: `flight` and below.
Start at: `recorder.Recorder`, `recorded_flight.RecordedFlight`.

A flight is one folder:

    flight.mcap    the log: every message of the table in `messages.py`, as JSON with its schema
    mavlink.tlog   every MAVLink packet, both ways
    video.mkv      the frames that vision saw
    config.yaml    settings as resolved, versions, hashes of networks, seed

Writing. A `Recorder` is a `FlightSink`: it makes the flight's log (`recorder.log`), which tells it
everything, and wraps the link's transport (`recorder.transport(...)`).

    config = FlightConfig.of("real", settings, run={"source": "rtsp://…"}, epoch_ns=started_ns)
    with Recorder(folder, config, clock, settings.recorder) as recorder:
        log = recorder.log                       # hand it to VisionLoop, ControlStage, ControlLoop
        link = MavlinkLink(recorder.transport(transport))
        ...
    recorder.remarks                             # what is missing, if anything

Whoever has frames, telemetry and steps but runs no flight calls `add_frame` and `add`, or the
log's own methods.

Reading. `open_flight` opens a folder, also one that a power cut ended or whose parts are missing.

    flight = open_flight(folder)                 # FlightFileError says in a line what is wrong
    flight.config                                # FlightConfig
    flight.log                                   # FlightLog: tracks, controls, events
    flight.selections, flight.detections, flight.observations, flight.frames, flight.truth
    flight.packets()                             # tlog.TlogPacket, in the order of time
    for frame in flight.pictures(): ...          # Frame: decoded, with number and capture time
    flight.remarks                               # what is missing or damaged, in sentences
    flight.messages()                            # (time_s, message) in the order written

Times are seconds on the flight's clock. `config.epoch_ns` says when its 0 was.
"""

from follower.recording.config import LOCKSTEP_EPOCH_NS, FlightConfig, epoch_now_ns
from follower.recording.mcap_writer import FlightFileError
from follower.recording.recorded_flight import RecordedFlight, open_flight
from follower.recording.recorder import Recorder
from follower.settings.recorder import RecorderSettings, VideoKind

__all__ = [
    "LOCKSTEP_EPOCH_NS",
    "FlightConfig",
    "FlightFileError",
    "RecordedFlight",
    "Recorder",
    "RecorderSettings",
    "VideoKind",
    "epoch_now_ns",
    "open_flight",
]
