"""Follows targets through a source of frames, recorded or live."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from follower.flight_video import FlightVideo
from follower.flightlog import FlightLog, FlightSink, Selection, TrackRecord
from follower.recorded import RecordedControl
from follower.selecting import TargetsSelector
from follower.stopwatch import Stopwatch
from follower_vision.box import Box
from follower_vision.clock import Clock
from follower_vision.frame import Frame
from follower_vision.framesource import FrameSource, SourceError
from follower_vision.live import LiveSource
from follower_vision.multi_target import MultiTargetTracker
from follower_vision.track import Track

MakeControl = Callable[[FlightLog, Frame], RecordedControl]


class TrackRun:
    """First finds the targets, then follows them to the source's end, or until it is stopped.

    `find` and `follow` are called one after the other, on any thread; `stop` and everything else
    on any other meanwhile.

    Args:
        source: at its beginning.
        tracker: not started yet.
        selector: finds the targets.
        count: how many there are.
        clock: the frames' own. A simulated one is moved along with them.
    """

    def __init__(
        self,
        source: FrameSource,
        tracker: MultiTargetTracker,
        selector: TargetsSelector,
        count: int,
        clock: Clock,
    ) -> None:
        self.source = source
        self.logs = [FlightLog() for _ in range(count)]
        self._tracker = tracker
        self._selector = selector
        self.clock = clock
        self._stop = threading.Event()
        self._found: tuple[Frame, list[Track]] | None = None
        self._box: Box | None = None
        self._size: tuple[int, int] | None = None
        self._problem: str | None = None

    @property
    def found(self) -> bool:
        """Whether the targets were found."""
        return self._found is not None

    @property
    def first(self) -> Frame:
        """The frame in which the targets were found."""
        return self._chosen()[0]

    def stop(self) -> None:
        """End `find` or `follow` after the frame that is being worked on."""
        self._stop.set()
        if isinstance(self.source, LiveSource):
            # Its reader may be waiting for a frame that never comes.
            self.source.close()

    @property
    def problem(self) -> str | None:
        """What ended the run early or is missing in it, in one line; None if nothing."""
        if self._problem is None and not isinstance(self.source, LiveSource):
            return self.source.problem
        return self._problem

    def find(self) -> bool:
        """Read frames until all targets are seen in one, and start there; return whether they are.

        Raises:
            SourceError: there is no frame at all, or the selector or the tracker refuses one.
        """
        while (frame := self._next()) is not None:
            timer, received_s = Stopwatch(), self.clock.now()
            boxes = self._selector(frame)
            tracks = self._started(frame, boxes) if boxes else []
            self._record(frame, tracks, received_s, timer.elapsed_s())
            if tracks:
                self._found = frame, tracks
                return True
        if not self.logs[0].tracks and not self._stop.is_set():
            raise SourceError(f"no frame could be read: {self.problem or 'the source is empty'}")
        return False

    def follow(
        self,
        video: FlightVideo | None = None,
        control: MakeControl | None = None,
        recorder: FlightSink | None = None,
    ) -> None:
        """Follow the targets from the frame in which they were found.

        Args:
            video: is given each frame.
            control: makes what steers by the first target, if anything is to.
            recorder: is told all about the first target.
        """
        current, tracks = self._chosen()
        if recorder is not None:
            self._begin_recording(recorder, current)
        frame: Frame | None = current
        steering = None if control is None else control(self.logs[0], current)
        while frame is not None:
            if video is not None:
                video.add(frame, tracks, ())
            frame = self._next()
            if steering is not None:
                newest = self.logs[0].tracks[-1]
                steering.step(newest, None if frame is None else frame.captured_s)
            if frame is not None:
                timer, received_s = Stopwatch(), self.clock.now()
                self.logs[0].see(frame, received_s)
                tracks = self._tracker.step(frame)
                self._record(frame, tracks, received_s, timer.elapsed_s())

    def _begin_recording(self, recorder: FlightSink, frame: Frame) -> None:
        log, record = self.logs[0], self.logs[0].tracks[-1]
        log.sink = recorder
        log.see(frame, record.received_s)
        if self._box is not None:
            chosen = Selection(frame.sequence, frame.captured_s, self._box)
            log.select(chosen, record.received_s)
        recorder.add_track(record)

    def _started(self, frame: Frame, boxes: Sequence[Box]) -> list[Track]:
        try:
            self._box = boxes[0]
            return self._tracker.start(frame, boxes)
        except ValueError as error:
            raise SourceError(f"this target cannot be followed: {error}") from error

    def _chosen(self) -> tuple[Frame, list[Track]]:
        if self._found is None:
            raise RuntimeError("no targets were found")
        return self._found

    def _next(self) -> Frame | None:
        """Return the next frame, None at the end; where the size changes is an end, too."""
        if self._stop.is_set():
            return None
        frame = self.source.read()
        if frame is None:
            return None
        size = frame.width, frame.height
        if self._size not in (None, size):
            self._problem = (
                f"frame {frame.sequence} is {size[0]}x{size[1]} pixels, the ones before were not: "
                "the run ends there; start another one"
            )
            return None
        self._size = size
        self.clock.sleep_until(frame.captured_s)
        return frame

    def _record(
        self, frame: Frame, tracks: Sequence[Track], received_s: float, busy_s: float
    ) -> None:
        """Log a frame for each target."""
        done_s = self.clock.now()
        for index, log in enumerate(self.logs):
            track = tracks[index] if tracks else None
            log.add_track(
                TrackRecord(track, frame.sequence, frame.captured_s, received_s, done_s, busy_s)
            )
