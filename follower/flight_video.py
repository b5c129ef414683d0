"""The flight's video with what the tracker saw drawn onto it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself
from follower_vision.overlay import draw_track
from follower_vision.track import Track
from follower_vision.video_writer import VideoWriteError, VideoWriter

_WAITING_FRAMES = 30


class FlightVideo(Protocol):
    """Takes every frame that vision answered for."""

    def add(self, frame: Frame, track: Track | None, lines: Sequence[str]) -> None:
        """Draw the track and the lines onto the frame and write it."""
        ...


class OverlayVideo(ClosesItself):
    """Draws and encodes at once: lockstep runs and `track`, where time waits."""

    remark: str | None = None

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._writer = VideoWriter(path, rate_hz)

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()

    def add(self, frame: Frame, track: Track | None, lines: Sequence[str]) -> None:
        """Draw and write."""
        self._writer.write(draw_track(frame.image, track, lines), frame.captured_s)


@dataclass(frozen=True, slots=True)
class _Entry:
    frame: Frame
    track: Track | None
    lines: tuple[str, ...]


class BackgroundVideo(ClosesItself):
    """Draws and encodes on its own thread, so that vision never waits.

    When the encoder falls behind, frames are left out and counted. When the disk is full it stops
    writing; the flight goes on. `remark` then says so.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path = path
        self._rate_hz = rate_hz
        self._waiting: queue.Queue[_Entry | None] = queue.Queue(_WAITING_FRAMES)
        self._left_out = 0
        self._problem: str | None = None
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self._thread.start()

    @property
    def remark(self) -> str | None:
        """What is missing in the video, None if nothing is."""
        if self._problem is not None:
            return f"The video ends early: {self._problem}"
        if self._left_out:
            return f"The video leaves out {self._left_out} frames: the encoder was too slow."
        return None

    def close(self) -> None:
        """Write what waits, and finish the file."""
        self._waiting.put(None)
        self._thread.join()

    def add(self, frame: Frame, track: Track | None, lines: Sequence[str]) -> None:
        """Hand the frame to the video's thread; never waits."""
        try:
            self._waiting.put_nowait(_Entry(frame, track, tuple(lines)))
        except queue.Full:
            self._left_out += 1

    def _run(self) -> None:
        try:
            with OverlayVideo(self._path, self._rate_hz) as video:
                while (entry := self._waiting.get()) is not None:
                    video.add(entry.frame, entry.track, entry.lines)
        except VideoWriteError as error:
            self._problem = str(error)
            while self._waiting.get() is not None:
                pass
