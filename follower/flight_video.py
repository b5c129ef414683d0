"""The flight's video with what the tracker saw drawn onto it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from follower_vision.frame import Frame
from follower_vision.overlay import draw_track
from follower_vision.track import Track
from follower_vision.video_writer import VideoWriteError, VideoWriter

_WAITING_FRAMES = 30


class FlightVideo(Protocol):
    """Takes every frame that vision answered for."""

    def add(self, frame: Frame, track: Track | None, lines: Sequence[str]) -> None:
        """Draw the track and the lines onto the frame and write it."""
        ...


class OverlayVideo:
    """Draws and encodes at once: lockstep runs and `track`, where time waits."""

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._writer = VideoWriter(path, rate_hz)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()

    def add(self, frame: Frame, track: Track | None, lines: Sequence[str]) -> None:
        """Draw and write."""
        self._writer.write(draw_track(frame.image, track, lines), frame.captured_s)


@dataclass(frozen=True, slots=True)
class _Entry:
    frame: Frame
    track: Track | None
    lines: tuple[str, ...]


class BackgroundVideo:
    """Draws and encodes on its own thread, so that vision never waits.

    When the encoder falls behind by `_WAITING_FRAMES`, frames are left out and counted. When the
    disk is full it stops writing and says so in `problem`; the flight goes on.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path = path
        self._rate_hz = rate_hz
        self._waiting: queue.Queue[_Entry | None] = queue.Queue(_WAITING_FRAMES)
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self.left_out = 0
        self.problem: str | None = None

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._waiting.put(None)
        self._thread.join()

    def add(self, frame: Frame, track: Track | None, lines: Sequence[str]) -> None:
        """Hand the frame to the video's thread; never waits."""
        try:
            self._waiting.put_nowait(_Entry(frame, track, tuple(lines)))
        except queue.Full:
            self.left_out += 1

    def _run(self) -> None:
        with OverlayVideo(self._path, self._rate_hz) as video:
            while (entry := self._waiting.get()) is not None:
                if self.problem is not None:
                    continue
                try:
                    video.add(entry.frame, entry.track, entry.lines)
                except VideoWriteError as error:
                    self.problem = str(error)
