"""Records a flight into its folder without ever holding it up."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from follower.flight.log import (
    ControlRecord,
    FlightLog,
    LogRecord,
    Stopwatch,
)
from follower.recording.append_file import AppendFile, BacklogError
from follower.recording.config import FlightConfig
from follower.recording.mcap_writer import McapLog
from follower.recording.messages import FrameRecord, messages_of
from follower.recording.tlog import Direction, TlogWriter
from follower.recording.video_writer import VideoQueue, give_way
from follower.settings.recorder import RecorderSettings, WhenFull
from follower_control.common.transport import Transport, WrappedTransport
from follower_sim.kinematics import TruthSample
from follower_vision.clock import Clock
from follower_vision.disk import failure_said
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself

LOG, TLOG, CONFIG = "flight.mcap", "mavlink.tlog", "config.yaml"
_COMMIT_EVERY_S, _COMMIT_EVERY = 0.4, 200
"""The log is put onto the disk after so many seconds; after so many records where the computer is
too busy to keep up, so that a disk that fills then keeps most of them."""
_LOOK_EVERY_S = 0.1
"""The log's thread is woken by the end of each control step alone, and looks by itself if none
comes: what it does in Python it does while control sleeps, not while control works."""
_MOST_ENTRIES = 20_000
_VIDEO_YIELDS_AT = _MOST_ENTRIES // 8


@dataclass(frozen=True, slots=True)
class Bytes:
    """What went over the link, not yet cut into packets."""

    data: bytes
    direction: Direction


class Recorder(ClosesItself):
    """Takes everything that happens in a flight and writes it on threads of its own.

    Handing something over takes microseconds and never waits. When the disk is slow, frames are
    left out of the video first; when it is full, the video ends first, and the log waits in memory
    for some time. Each such trouble is told once, with the file and what is still free, as an event
    in the log and a line in `remarks`; the flight goes on, if `must_stop` does not say else.

    Args:
        folder: exists; the files must not exist yet.
        config: what is flown.
        clock: the flight's.
        settings: see there.
        threaded: False writes at once on the caller's thread, so that nothing can be left out:
            for lockstep.
        kept: how much of the log stays in memory, see `FlightLog`.

    Attributes:
        log: the flight's log, which writes here.

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
        with AppendFile(folder / CONFIG) as file:
            file.write(config.to_yaml().encode())
            file.commit()
        self._entries: deque[tuple[object, float]] = deque()
        self._step_ended = threading.Event()
        self._closing = False
        self._lost, self._left_out = 0, False
        self._when_full = (settings or RecorderSettings()).when_full
        self._writer = _LogWriter(folder, config, self._report)
        self._video = VideoQueue(folder, settings or RecorderSettings(), self._report, threaded)
        self._committed_s = clock.now()
        self._thread: threading.Thread | None = None
        self._writer.commit()  # the head: killed at any time, the log can be read
        if threaded:
            self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
            self._thread.start()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is missing in the recording, in sentences; nothing, usually."""
        return tuple(self._remarks)

    @property
    def must_stop(self) -> bool:
        """Whether the disk has no room, and the settings want no flight without a recording."""
        full = self._writer.out_of_room or self._video.out_of_room
        return full and self._when_full is WhenFull.STOP

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
        if self._lost and not self._writer.out_of_room:
            self._report(f"{self._lost} messages are not in the log: the disk was too slow")
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

    def add(self, record: LogRecord | TruthSample | Bytes, time_s: float) -> None:
        """Record anything else: `time_s` is in seconds on the flight's clock."""
        self._put(record, time_s)
        if isinstance(record, ControlRecord):
            self._step_ended.set()

    def _put(self, record: object, time_s: float) -> None:
        if self._thread is None:
            for message in messages_of(record):
                self._writer.write(message, time_s)
            if time_s - self._committed_s > _COMMIT_EVERY_S:
                self._committed_s = time_s
                self._writer.commit()
        elif len(self._entries) < _MOST_ENTRIES:
            self._entries.append((record, time_s))
        else:
            self._lost += 1

    def _report(self, trouble: str) -> None:
        self._remarks.append(f"Recorder: {trouble}.")
        self.log.note(self._clock.now(), "recorder", trouble)

    def _run(self) -> None:
        give_way()
        since, waiting = Stopwatch(), 0
        closing = False
        while not closing:
            self._step_ended.wait(_LOOK_EVERY_S)
            self._step_ended.clear()
            closing = self._closing
            while self._entries:
                self._write(*self._entries.popleft())
                waiting += 1
                if waiting >= _COMMIT_EVERY:
                    self._writer.commit()
                    since, waiting = Stopwatch(), 0
            if since.elapsed_s() >= _COMMIT_EVERY_S:
                self._writer.commit()
                since, waiting = Stopwatch(), 0

    def _write(self, record: object, time_s: float) -> None:
        """Write a record; between any two messages, who else wants to run may."""
        try:
            for message in messages_of(record):
                self._writer.write(message, time_s)
                time.sleep(0)
        except Exception as error:  # a plug-in's answer, perhaps: what follows is not to be lost
            if not self._left_out:
                self._left_out = True
                self._report(f"left out what cannot be written, {type(record).__name__}: {error}")


class RecordedTransport(WrappedTransport):
    """A transport whose bytes are recorded, both ways."""

    def __init__(self, inner: Transport, recorder: Recorder, clock: Clock) -> None:
        super().__init__(inner)
        self._recorder = recorder
        self._clock = clock

    def send(self, data: bytes) -> None:
        """Send and record one packet."""
        super().send(data)
        self._recorder.add(Bytes(data, Direction.SENT), self._clock.now())

    def receive(self) -> bytes:
        """Return and record what has arrived."""
        data = super().receive()
        if data:
            self._recorder.add(Bytes(data, Direction.RECEIVED), self._clock.now())
        return data


class _LogWriter(ClosesItself):
    """Encodes messages and packets, and commits them on request.

    A full disk is reported once; what cannot be written waits, and is written when there is
    room again. When too much waits, the log ends there.

    Attributes:
        out_of_room: the disk did not take all, and has not since.

    Raises:
        OSError: by the constructor, if the files cannot be made.
    """

    def __init__(self, folder: Path, config: FlightConfig, report: Callable[[str], None]) -> None:
        self._folder = folder
        self._log = McapLog(folder / LOG, config.epoch_ns, config.to_yaml())
        self._tlog = TlogWriter(folder / TLOG, config.epoch_ns)
        self._report = report
        self.out_of_room = self._ended = False

    def write(self, message: object, time_s: float) -> None:
        """Encode a record, or `Bytes`, of `time_s` in seconds on the flight's clock."""
        if self._ended:
            return
        if isinstance(message, Bytes):
            self._tlog.write(message.data, message.direction, time_s)
        else:
            self._log.write(message, time_s)

    def commit(self) -> None:
        """Put everything onto the disk, if the disk allows."""
        if self._ended:
            return
        try:
            self._log.commit()
            self._tlog.commit()
        except OSError as error:
            self._ended = isinstance(error, BacklogError)
            self._fail("stops here, what comes waits in memory for some time", error)
        else:
            if self.out_of_room:
                self._report("the log is written again, nothing is missing in it")
            self.out_of_room = False

    def close(self) -> None:
        """Commit and finish the files, as far as the disk allows."""
        for file in (self._log, self._tlog):
            try:
                file.close()
            except OSError as error:
                self._fail("has no end", error)

    def _fail(self, what: str, error: OSError) -> None:
        if not self.out_of_room:
            why = failure_said(error, Path(error.filename or self._folder))
            self._report(f"the log {what}: {why}")
        self.out_of_room = True
