"""Records a flight into its folder without ever holding it up."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from pathlib import Path

from follower.flightlog import (
    ControlRecord,
    Event,
    FlightLog,
    Observation,
    Selection,
    TrackRecord,
)
from follower.recorder.config import FlightConfig
from follower.recorder.log_writer import Bytes, Entry, LogWriter, messages_of
from follower.recorder.priority import give_way
from follower.recorder.records import FrameRecord
from follower.recorder.tlog import Direction
from follower.recorder.video_queue import VideoQueue
from follower.recorder_settings import RecorderSettings
from follower.stopwatch import Stopwatch
from follower_control.transport import Transport
from follower_sim.truth_sample import TruthSample
from follower_vision.clock import Clock
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself

CONFIG = "config.yaml"
_COMMIT_EVERY_S = 0.4
_LOOK_EVERY_S = 0.1
"""The log's thread is woken by the end of each control step alone, and looks by itself if none
comes: what it does in Python it does while control sleeps, not while control works."""
_MOST_ENTRIES = 20_000
_VIDEO_YIELDS_AT = _MOST_ENTRIES // 8


class Recorder(ClosesItself):
    """Takes everything that happens in a flight and writes it on threads of its own.

    Handing something over takes microseconds and never waits. When the disk is slow, frames are
    left out of the video first; when it is full, the video ends first, and the log waits in memory.
    Each such trouble is an event in the log and a line in `remarks`; the flight goes on.

    Args:
        folder: exists; the files must not exist yet.
        config: what is flown.
        clock: the flight's.
        settings: see there.
        threaded: False writes at once on the caller's thread, so that nothing can be left out:
            for lockstep.
        kept: how much of the log stays in memory, see `FlightLog`.

    Raises:
        OSError: the files cannot be made.
    """

    def __init__(
        self,
        folder: Path,
        config: FlightConfig,
        clock: Clock,
        settings: RecorderSettings | None = None,
        threaded: bool = True,
        kept: int | None = None,
    ) -> None:
        self._clock = clock
        self._remarks: list[str] = []
        self.log = FlightLog(sink=self, kept=kept)
        _write_to_disk(folder / CONFIG, config.to_yaml())
        self._entries: deque[Entry] = deque()
        self._step_ended = threading.Event()
        self._closing = False
        self._lost = 0
        self._writer = LogWriter(folder, config, self._tell)
        self._video = VideoQueue(folder, settings or RecorderSettings(), self._tell, threaded)
        self._committed_s = clock.now()
        self._thread: threading.Thread | None = None
        if threaded:
            self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
            self._thread.start()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is missing in the recording, in sentences; nothing, usually."""
        return tuple(self._remarks)

    def transport(self, transport: Transport) -> Transport:
        """Return a transport that does the same and is recorded."""
        return RecordedTransport(transport, self, self._clock)

    def close(self) -> None:
        """Write what waits and finish the files."""
        self._video.close()
        if self._thread is not None:
            self._closing = True
            self._step_ended.set()
            self._thread.join()
            self._thread = None
        if self._lost:
            self._tell(f"{self._lost} messages are not in the log: the disk was too slow")
        self._writer.close()

    def add_frame(self, frame: Frame, received_s: float) -> None:
        """Record a frame that vision begins to work on."""
        index = None
        if len(self._entries) > _VIDEO_YIELDS_AT:
            self._video.leave_out("the disk is too slow")
        else:
            index = self._video.offer(frame)
        size = frame.width, frame.height
        record = FrameRecord(frame.sequence, frame.captured_s, received_s, *size, index)
        self._put(record, received_s)

    def add_selection(self, selection: Selection, received_s: float) -> None:
        """Record that a target was chosen."""
        self._put(selection, received_s)

    def add_track(self, record: TrackRecord) -> None:
        """Record vision's answer."""
        self._put(record, record.done_s)

    def add_observation(self, observation: Observation) -> None:
        """Record what control made of a track."""
        self._put(observation, observation.time_s)

    def add_control(self, record: ControlRecord) -> None:
        """Record a control step."""
        self._put(record, record.time_s)
        self._step_ended.set()

    def add_event(self, event: Event) -> None:
        """Record an event."""
        self._put(event, event.time_s)

    def add_truth(self, sample: TruthSample) -> None:
        """Record the simulator's truth, for score and report."""
        self._put(sample, sample.time_s)

    def add_bytes(self, data: bytes, direction: Direction, time_s: float) -> None:
        """Record what went over the link."""
        self._put(Bytes(data, direction), time_s)

    def _put(self, record: object, time_s: float) -> None:
        entry = (record, time_s)
        if self._thread is None:
            for message, at_s in messages_of(entry):
                self._writer.write(message, at_s)
            if time_s - self._committed_s > _COMMIT_EVERY_S:
                self._committed_s = time_s
                self._writer.commit()
        elif len(self._entries) < _MOST_ENTRIES:
            self._entries.append(entry)
        else:
            self._lost += 1

    def _tell(self, trouble: str) -> None:
        self._remarks.append(f"Recorder: {trouble}.")
        self.log.note(self._clock.now(), "recorder", trouble)

    def _run(self) -> None:
        give_way()
        since = Stopwatch()
        closing = False
        while not closing:
            self._step_ended.wait(_LOOK_EVERY_S)
            self._step_ended.clear()
            closing = self._closing
            self._drain()
            if since.elapsed_s() >= _COMMIT_EVERY_S:
                self._writer.commit()
                since = Stopwatch()

    def _drain(self) -> None:
        """Write what has come; between any two messages, who else wants to run may."""
        while self._entries:
            for message, time_s in messages_of(self._entries.popleft()):
                self._writer.write(message, time_s)
                time.sleep(0)


def _write_to_disk(path: Path, text: str) -> None:
    """Write a file that a power cut a moment later leaves whole."""
    with path.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


class RecordedTransport:
    """A transport whose bytes are recorded, both ways."""

    def __init__(self, transport: Transport, recorder: Recorder, clock: Clock) -> None:
        self._transport = transport
        self._recorder = recorder
        self._clock = clock

    def send(self, data: bytes) -> None:
        """Send and record one packet."""
        self._transport.send(data)
        self._recorder.add_bytes(data, Direction.SENT, self._clock.now())

    def receive(self) -> bytes:
        """Return and record what has arrived."""
        data = self._transport.receive()
        if data:
            self._recorder.add_bytes(data, Direction.RECEIVED, self._clock.now())
        return data

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()
