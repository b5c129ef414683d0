"""The flight's video with what the tracker saw drawn onto it."""

import queue
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from follower_vision.disk import is_short_of_room, room_said
from follower_vision.drawing.overlay import draw_tracks
from follower_vision.drawing.video_writer import VideoWriteError, VideoWriter
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself
from follower_vision.trackers.track import Track

_WAITING_FRAMES = 30
_LOOK_EVERY = 30
"""Frames from one look at the disk's room to the next."""


class FlightVideo(Protocol):
    """Takes every frame that vision answered for."""

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Draw the tracks (none while there is no target) and the lines, and write the frame."""
        ...


class SeveralVideos:
    """Hands each frame to several."""

    def __init__(self, videos: Sequence[FlightVideo]) -> None:
        self._videos = tuple(videos)

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Hand it on."""
        for video in self._videos:
            video.add(frame, tracks, lines)


class OverlayVideo(ClosesItself):
    """Draws and encodes at once: lockstep runs, where time waits.

    When the disk is full it stops writing; the flight goes on. `remark` then says so.

    Args:
        path: the file.
        rate_hz: about how many frames a second there will be.
        keep_free_mb: it stops where the disk has less room than this, which other files need.

    Attributes:
        remark: what is missing in the video, None if nothing is.
    """

    def __init__(self, path: Path, rate_hz: float, keep_free_mb: float = 0.0) -> None:
        self._writer = VideoWriter(path, rate_hz)
        self._keep_free_mb = keep_free_mb
        self._added = 0
        self.remark: str | None = None

    def close(self) -> None:
        """Finish the file."""
        with self._ending_early():
            self._writer.close()

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Draw and write."""
        if self.remark is None and self._added % _LOOK_EVERY == 0:
            self._leave_room()
        self._added += 1
        if self.remark is None:
            with self._ending_early():
                self._writer.write(draw_tracks(frame.image, tracks, lines), frame.captured_s)

    def _leave_room(self) -> None:
        path = self._writer.path
        if is_short_of_room(path, self._keep_free_mb):
            self.remark = f"The video ends early: other files need the room ({room_said(path)})"

    @contextmanager
    def _ending_early(self) -> Iterator[None]:
        try:
            yield
        except VideoWriteError as error:
            self.remark = f"The video ends early: {error}"
        except Exception as error:  # a video ends no flight, and no thread that others wait for
            self.remark = f"The video ends early: {type(error).__name__}: {error}"


class BackgroundVideo(ClosesItself):
    """Draws and encodes on its own thread, so that vision never waits.

    When the encoder falls behind, frames are left out and counted. When the disk is full it stops
    writing; the flight goes on. `remark` then says so.

    Args:
        path: the file.
        rate_hz: about how many frames a second there will be.
        patient: rather wait for the encoder than leave a frame out: for recordings.
        keep_free_mb: see `OverlayVideo`.
    """

    def __init__(
        self, path: Path, rate_hz: float, patient: bool = False, keep_free_mb: float = 0.0
    ) -> None:
        self._patient = patient
        self._waiting: queue.Queue[tuple[Frame, Sequence[Track], Sequence[str]] | None] = (
            queue.Queue(_WAITING_FRAMES)
        )
        self._left_out = 0
        self._video = OverlayVideo(path, rate_hz, keep_free_mb)
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self._thread.start()

    @property
    def remark(self) -> str | None:
        """What is missing in the video, None if nothing is."""
        if self._video.remark is None and self._left_out:
            return f"The video leaves out {self._left_out} frames: the encoder was too slow."
        return self._video.remark

    def close(self) -> None:
        """Write what waits, and finish the file."""
        self._waiting.put(None)
        self._thread.join()

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Hand the frame to the video's thread; waits only if that was asked for."""
        try:
            self._waiting.put((frame, tuple(tracks), tuple(lines)), block=self._patient)
        except queue.Full:
            self._left_out += 1

    def _run(self) -> None:
        with self._video as video:
            while (entry := self._waiting.get()) is not None:
                video.add(*entry)
