"""Runs the stages in real time, a thread each."""

import gc
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager

import cv2

from follower.flight.control.loop import ControlLoop
from follower.flight.log import (
    DetectionRecord,
    FlightLog,
    SelectionRecord,
    Stopwatch,
    TrackRecord,
)
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.video_sink import FlightVideo
from follower_control.common.interrupt import interrupted_later
from follower_vision.clock import Clock
from follower_vision.images.frame import Frame
from follower_vision.mailbox import Mailbox
from follower_vision.sources.frame_source import FrameSource


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Have OpenCV use one thread while entered, as every flight and replay does."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


_SWITCH_INTERVAL_S = 0.0005
"""Python hands the interpreter from thread to thread this often; its own 5 ms would show as
jitter of the control loop while vision runs Python code."""
_NEVER = 1_000_000_000
_MANY_NEW = 100_000
"""So many new objects are looked through at a time, where pauses do not matter."""


@contextmanager
def short_pauses() -> Iterator[None]:
    """Switch threads often, and look through old objects for cyclic garbage only afterwards.

    Such a look stops every thread for as long as it takes, and it takes longer the more a flight
    has noted down: 0.13 s after some minutes. What is young is still looked through.
    """
    interval_s, thresholds = sys.getswitchinterval(), gc.get_threshold()
    gc.collect()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    gc.set_threshold(*thresholds[:2], _NEVER)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)
        sys.setswitchinterval(interval_s)


@contextmanager
def few_collections() -> Iterator[None]:
    """Look for cyclic garbage seldom, for what keeps most of the objects that it makes."""
    before = gc.get_threshold()
    gc.set_threshold(_MANY_NEW, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


_PATIENCE_S = 0.2
_LONGEST_BRAKING_S = 6.0
_LAST_WORDS = 5
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.02, 0.1
_GROWS, _WEARS_OFF = 1.5, 0.95
_BETWEEN_WORDS_S = 0.06


class VisionLoop:
    """What the vision thread does with each frame; also called directly in lockstep."""

    def __init__(
        self,
        stage: VisionStage,
        clock: Clock,
        log: FlightLog,
        video: FlightVideo | None = None,
        lines: Callable[[], Sequence[str]] = tuple,
        on_record: Callable[[TrackRecord], None] | None = None,
    ) -> None:
        self._stage = stage
        self._clock = clock
        self._log = log
        self._video = video
        self._lines = lines
        self._on_record = on_record
        self.tracks: Mailbox[TrackRecord] = Mailbox()

    @property
    def is_free(self) -> bool:
        """Whether it takes a frame now, on a clock that stands still."""
        return True

    @property
    def needs_picture(self) -> bool:
        """Whether the next frame's picture is used."""
        return self._video is not None or self._log.sink is not None or self._stage.needs_picture

    def step(self, frame: Frame, delay_s: float = 0.0) -> TrackRecord:
        """Answer for one frame.

        Args:
            frame: the newest frame.
            delay_s: how long the answer is held to take on a clock that stands still.
        """
        received_s = self._clock.now()
        self._log.pass_frame_on(frame, received_s)
        timer = Stopwatch()
        try:
            track = self._stage.step(frame)
        except Exception as error:  # what ends vision is to be known while the flight goes on
            self._log.note(received_s, "vision", f"failed: {type(error).__name__}: {error}")
            raise
        busy_s = timer.elapsed_s()
        done_s = max(self._clock.now(), received_s + delay_s)
        record = TrackRecord(
            track,
            frame.sequence,
            frame.captured_s,
            received_s,
            done_s,
            busy_s,
            self._stage.requests_done,
            self._stage.prospect,
            self._stage.replaced or None,
        )
        if self._stage.chosen is not None or self._stage.dropped:
            chosen = SelectionRecord(frame.sequence, frame.captured_s, self._stage.chosen)
            self._log.pass_on(chosen, received_s)
        for answer in self._stage.detected:
            number, seen = answer.request.index, tuple(answer.detections)
            detected = DetectionRecord(frame.sequence, frame.captured_s, number, seen)
            self._log.pass_on(detected, received_s)
        self._log.add_track(record)
        if self._video is not None:
            self._video.add(frame, () if track is None else (track,), self._lines())
        if self._on_record is not None:
            self._on_record(record)
        return record


def _started(loop: Callable[[], None]) -> Future[None]:
    """Run a loop on a thread that does not keep the program alive if it hangs."""
    future: Future[None] = Future()

    def run() -> None:
        try:
            loop()
        except BaseException as error:  # whoever looks at the future raises it again
            future.set_exception(error)
        else:
            future.set_result(None)

    threading.Thread(target=run, name=loop.__name__, daemon=True).start()
    return future


class VisionPause:
    """How long vision rests after a frame, so that control is on time on a board that is too small.

    A quota of the kernel stops all threads of a process alike once it is spent, and a slow
    processor makes them wait for each other: fewer frames cost less, in vision and in whatever
    records and shows them. The pause grows when control was late since the last frame, and wears
    off while it is on time.

    Args:
        late_s: what is late, in seconds.
    """

    def __init__(self, late_s: float) -> None:
        self._late_s = late_s
        self._was_late = False
        self._pause_s = 0.0

    def note(self, late_s: float) -> None:
        """Take in how late a control step began, in seconds."""
        self._was_late |= late_s > self._late_s

    def after_frame(self) -> float:
        """Return how long to rest now, in seconds."""
        if self._was_late:
            self._pause_s = min(max(_GROWS * self._pause_s, _FIRST_PAUSE_S), _LONGEST_PAUSE_S)
        else:
            self._pause_s *= _WEARS_OFF
        self._was_late = False
        return self._pause_s if self._pause_s > _FIRST_PAUSE_S / 4 else 0.0


class RealtimeRun:
    """Capture, vision and control, each on its own thread, until told to stop."""

    def __init__(
        self,
        clock: Clock,
        source: FrameSource,
        vision: VisionLoop,
        control: ControlLoop,
        control_rate_hz: float,
    ) -> None:
        self._clock = clock
        self._source = source
        self._vision = vision
        self._control = control
        self._period_s = 1.0 / control_rate_hz
        self._frames: Mailbox[Frame] = Mailbox()
        self._pause = VisionPause(late_s=self._period_s / 2)
        self._stop = threading.Event()

    def run(self, watch: Callable[[], bool], watch_every_s: float = 0.1) -> None:
        """Run until `watch()`, called on this thread, returns False, or a stage fails.

        However it ends, holds are sent last. A stage's error is raised here, after control has
        gone on for as long as `watch` wants: a dead vision thread shows as stale frames, on which
        the supervisor holds and releases the vehicle. One that hangs is left behind. If `watch`
        itself fails, control brakes and releases the vehicle before its error is raised.
        """
        loops = (self._capture_loop, self._vision_loop, self._control_loop)
        with short_pauses():
            futures = [_started(loop) for loop in loops]
            try:
                while watch() and not futures[-1].done():
                    wait(futures[-1:], watch_every_s)
            except (Exception, SystemExit):  # rich exits where nobody reads its output any more
                self._brake(futures[-1])
                raise
            finally:
                self._shut_down(futures)
        for future in futures:
            if future.done():
                future.result()

    def _brake(self, control: Future[None]) -> None:
        """Let a control loop that is well come to rest."""
        self._control.release()
        until_s = self._clock.now() + _LONGEST_BRAKING_S
        wait([control], 2 * self._period_s)
        while not (control.done() or self._control.rests) and self._clock.now() < until_s:
            wait([control], self._period_s)

    def _shut_down(self, futures: Sequence[Future[None]]) -> None:
        self._stop.set()
        self._frames.close()
        with interrupted_later():  # by a Ctrl-C that is held down, a velocity would come last
            wait(futures[-1:], 10 * _PATIENCE_S)
            for _ in range(_LAST_WORDS):  # one alone may get lost
                if not self._control.hold():
                    break
                self._clock.sleep_until(self._clock.now() + _BETWEEN_WORDS_S)
        wait(futures, 10 * _PATIENCE_S)
        if not futures[0].done():
            self._source.close()  # its reader waits for a frame that never comes

    def _capture_loop(self) -> None:
        while not self._stop.is_set():
            frame = self._source.read()
            if frame is None:
                return
            self._frames.put(frame)

    def _vision_loop(self) -> None:
        while not self._stop.is_set():
            frame = self._frames.wait(_PATIENCE_S)
            if frame is not None:
                self._vision.tracks.put(self._vision.step(frame))
                self._clock.sleep_until(self._clock.now() + self._pause.after_frame())

    def _control_loop(self) -> None:
        due_s = self._clock.now()
        while not self._stop.is_set():
            self._clock.sleep_until(due_s)
            now_s = self._clock.now()
            self._pause.note(now_s - due_s)
            self._control.step(now_s, now_s - due_s)
            # Steps that were missed are left out, so that a stall is no burst afterwards.
            missed = max(0.0, self._clock.now() - due_s) // self._period_s
            due_s += (1 + missed) * self._period_s
