"""Frames on their way to the video: a bounded number of bytes, and a thread that encodes them."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

from follower.recorder.priority import give_way
from follower.recorder.video_file import VideoFile, VideoFileError
from follower.recorder_settings import RecorderSettings, VideoKind
from follower.stopwatch import Stopwatch
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself

VIDEO = "video.mkv"
_SYNC_EVERY_S = 0.5


class VideoQueue(ClosesItself):
    """Takes frames without waiting; refuses those for which there is no room.

    Args:
        folder: gets the video.
        settings: see there.
        tell: is told, once each, that frames are left out and that the video had to end.
        threaded: False encodes on the caller's thread, which waits: for lockstep.
    """

    def __init__(
        self,
        folder: Path,
        settings: RecorderSettings,
        tell: Callable[[str], None],
        threaded: bool = True,
    ) -> None:
        self._folder = folder
        self._settings = settings
        self._tell = tell
        self._file = VideoFile(folder / VIDEO, settings)
        self._changed = threading.Condition()
        self._waiting: deque[Frame] = deque()
        self._waiting_bytes = 0
        self._size: tuple[int, int] | None = None
        self._accepted = 0
        self._ended = settings.video is VideoKind.NONE
        self._closing = False
        self._since_sync = Stopwatch()
        self.left_out = 0
        self._thread: threading.Thread | None = None
        if threaded and not self._ended:
            self._thread = threading.Thread(target=self._run, name="video", daemon=True)
            self._thread.start()

    def offer(self, frame: Frame) -> int | None:
        """Take a frame and return its number in the video; None if it is left out of it."""
        with self._changed:
            refused = self._refusal(frame)
            if refused is None:
                index, self._accepted = self._accepted, self._accepted + 1
                self._waiting.append(frame)
                self._waiting_bytes += frame.image.nbytes
                self._changed.notify()
        if refused is not None:
            self.leave_out(refused)
            return None
        if self._thread is None:
            self._write(self._waiting.popleft())
        return index

    def leave_out(self, why: str) -> None:
        """Count a frame that is not in the video, and tell the first reason."""
        if self._settings.video is VideoKind.NONE:
            return
        self.left_out += 1
        if self.left_out == 1 and why:
            self._tell(f"frames are left out of the video: {why}")

    def close(self) -> None:
        """Encode what waits and finish the video."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()
        try:
            self._file.close()
        except VideoFileError as error:
            self._end(f"its end could not be written ({error.strerror})")
        if self.left_out:
            self._tell(f"{self.left_out} frames are not in the video")

    def _refusal(self, frame: Frame) -> str | None:
        """Say why a frame is left out; the first frame decides on the size."""
        size = frame.width, frame.height
        if self._ended:
            return ""
        if self._size not in (None, size):
            return f"the frames changed their size to {size[0]}x{size[1]}"
        most = self._settings.buffer_mb * 1e6
        if self._waiting and self._waiting_bytes + frame.image.nbytes > most:
            return "the disk or the encoder is too slow"
        self._size = size
        return None

    def _run(self) -> None:
        give_way()
        while (frame := self._next()) is not None:
            self._write(frame)

    def _next(self) -> Frame | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closing)
            return self._waiting.popleft() if self._waiting else None

    def _write(self, frame: Frame) -> None:
        if not self._ended:
            try:
                self._file.write(frame)
                if self._since_sync.elapsed_s() > _SYNC_EVERY_S:
                    self._file.sync()
                    self._since_sync = Stopwatch()
                    self._check_room()
            except VideoFileError as error:
                self._end(error.strerror or "the disk failed")
        with self._changed:
            self._waiting_bytes -= frame.image.nbytes

    def _check_room(self) -> None:
        disk = os.statvfs(self._folder)
        free_mb = disk.f_bavail * disk.f_frsize / 1e6
        if free_mb < self._settings.keep_free_mb:
            self._end(f"only {free_mb:.0f} MB are left on the disk, which the log needs")
            self._file.close()

    def _end(self, why: str) -> None:
        self._ended = True
        self._tell(f"the video ends here: {why}")
