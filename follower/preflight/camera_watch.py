"""Watches a camera for a while: how often, how steadily, how late its frames come."""

from __future__ import annotations

import math
import threading
from collections import deque
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import numpy as np

from follower.preflight.snapshot import CameraReading
from follower_vision.clock import Clock
from follower_vision.frame import Frame
from follower_vision.framesource import FrameSource
from follower_vision.mailbox import Mailbox

_MOST = 600
_WINDOW_S = 3.0
"""A stream that begins with a gap is not blamed for it for ever."""
_EVERY_NTH_PIXEL = 4
_JOIN_S = 3.0


class CameraWatch:
    """Reads a source on a thread of its own while it is entered; the source stays open.

    Args:
        source: at its beginning, or live.
        name: of the source, for people.
        clock: on which frames are timed.

    Attributes:
        frames: the newest frame, for whoever looks at it.
    """

    def __init__(self, source: FrameSource, name: str, clock: Clock) -> None:
        self._source = source
        self._name = name
        self._clock = clock
        self._lock = threading.Lock()
        self._captured_s: deque[float] = deque(maxlen=_MOST)
        self._ages_s: deque[float] = deque(maxlen=_MOST)
        self._count = self._repeats = 0
        self._newest: Frame | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera watch", daemon=True)
        self.frames: Mailbox[Frame] = Mailbox()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.callback(self._end)  # Ctrl-C may come when the thread already reads
            self._thread.start()
            stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()

    def _end(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)

    def reading(self) -> CameraReading:
        """Return what was seen in the last three seconds."""
        newest, problem = self._newest, self._source.problem or ""
        if newest is None:
            return CameraReading(self._name, problem)
        with self._lock:
            captured_s, ages_s = tuple(self._captured_s), tuple(self._ages_s)
        # The gap that has not ended yet counts, too: a camera that has died has no next frame.
        ended_s = max(captured_s[-1], self._clock.now() - ages_s[-1])
        intervals = np.diff(captured_s)
        median = float(np.median(intervals)) if len(intervals) else math.nan
        deviation = np.abs(intervals - median)
        return CameraReading(
            self._name,
            problem,
            (newest.width, newest.height),
            self._count,
            median,
            float(max(*intervals, ended_s - captured_s[-1])) if len(intervals) > 1 else math.nan,
            float(np.percentile(deviation, 95)) if len(intervals) else math.nan,
            float(np.percentile(ages_s, 95)),
            float(newest.image[::_EVERY_NTH_PIXEL, ::_EVERY_NTH_PIXEL].mean(2).std()),
            self._repeats,
        )

    def _run(self) -> None:
        while not self._stop.is_set():
            frame = self._source.read()
            if frame is None:
                return
            self._take(frame)

    def _take(self, frame: Frame) -> None:
        before, self._newest = self._newest, frame
        self._count += 1
        if before is not None and np.array_equal(_sample(before), _sample(frame)):
            self._repeats += 1
        with self._lock:
            self._ages_s.append(self._clock.now() - frame.captured_s)
            self._captured_s.append(frame.captured_s)
            while self._captured_s[0] < frame.captured_s - _WINDOW_S:
                self._captured_s.popleft()
                self._ages_s.popleft()
        self.frames.put(frame)


def _sample(frame: Frame) -> np.ndarray:
    return frame.image[:: 2 * _EVERY_NTH_PIXEL, :: 2 * _EVERY_NTH_PIXEL]
