"""The flight recorder: writes a flight's folder, and reads it again.

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

Whoever has frames, telemetry and steps but runs no flight calls `add_frame`, `add_track`,
`add_control`, … or the log's own methods.

Reading. `open_flight` opens a folder, also one that a power cut ended or whose parts are missing.

    flight = open_flight(folder)                 # FlightFileError says in a line what is wrong
    flight.config                                # FlightConfig
    flight.log                                   # FlightLog: tracks, controls, events
    flight.selections, flight.observations, flight.frames, flight.truth
    flight.packets()                             # tlog.Packet, in the order of time
    for frame in flight.pictures(): ...          # Frame: decoded, with number and capture time
    flight.remarks                               # what is missing or damaged, in sentences
    flight.messages()                            # (time_s, message) in the order written

Times are seconds on the flight's clock. `config.epoch_ns` says when its 0 was.
"""

from follower.recorder.config import LOCKSTEP_EPOCH_NS, FlightConfig, epoch_now_ns
from follower.recorder.reading import FlightFileError
from follower.recorder.recorded_flight import RecordedFlight, open_flight
from follower.recorder.recorder import Recorder
from follower.recorder_settings import RecorderSettings, VideoKind

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
