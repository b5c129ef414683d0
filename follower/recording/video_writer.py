"""Writes `video.mkv`: the frames that vision saw, playable up to a killed process's last second."""

import os
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import av.container
import av.error
import cv2
import numpy as np

from follower.flight.log import Stopwatch
from follower.settings.recorder import RecorderSettings, VideoKind
from follower_vision.disk import failure_said, is_no_room, is_short_of_room, room_said
from follower_vision.images.frame import Frame, Image
from follower_vision.sources.frame_source import ClosesItself

LOSSLESS_FORMAT, LOSSY_FORMAT = "bgr24", "yuv420p"
TICK = Fraction(1, 1000)
"""Seconds. Matroska's own resolution; the exact capture times are in the log."""


class FrameTimes:
    """At which tick of a video each of its pictures stands: the first at 0, no two at one."""

    def __init__(self) -> None:
        self._origin_s: float | None = None
        self._tick = -1

    def of(self, captured_s: float) -> int:
        """Return the next picture's, by the frame's capture time."""
        if self._origin_s is None:
            self._origin_s = captured_s
        self._tick = max(self._tick + 1, round((captured_s - self._origin_s) / TICK))
        return self._tick


def to_picture(image: Image, lossless: bool) -> av.VideoFrame:
    """Return the image as the encoder takes it; for H.264 it is grown to multiples of 4 pixels."""
    if lossless:
        return av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format=LOSSLESS_FORMAT)
    planes = np.asarray(cv2.cvtColor(_grown(image), cv2.COLOR_BGR2YUV_I420), np.uint8)
    return av.VideoFrame.from_numpy_buffer(planes, format=LOSSY_FORMAT)


def to_image(picture: av.VideoFrame, width: int, height: int) -> Image:
    """Return a decoded picture as (height, width, 3) BGR."""
    if picture.format.name == LOSSY_FORMAT:
        image = cv2.cvtColor(picture.to_ndarray(), cv2.COLOR_YUV2BGR_I420)
    else:
        image = picture.to_ndarray(format=LOSSLESS_FORMAT)
    return np.ascontiguousarray(image[:height, :width], np.uint8)


def lossy_size(width: int, height: int) -> tuple[int, int]:
    """Return the size that an image has in H.264: OpenCV and PyAV agree on multiples of 4."""
    return width + -width % 4, height + -height % 4


def _grown(image: Image) -> Image:
    down, right = -image.shape[0] % 4, -image.shape[1] % 4
    if not down and not right:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE), np.uint8)


_LOSSLESS_CODEC, _LOSSY_CODEC = "libx264rgb", "libx264"
_CLUSTER_MS = "400"
_KEY_FRAME_EVERY = "30"
_FAILURES = (av.error.FFmpegError, OSError, ValueError)
"""A codec that this FFmpeg lacks is a ValueError of PyAV's."""


class VideoFileError(OSError):
    """The video cannot be written; the message says why in a few words."""


class MatroskaWriter(ClosesItself):
    """Encodes frames of one size into a Matroska file, each at once: none waits for another.

    Args:
        path: is made with the first frame.
        settings: the codec and its quality.

    Raises:
        VideoFileError: by `write` and `close`.
    """

    def __init__(self, path: Path, settings: RecorderSettings) -> None:
        self._path = path
        self._lossless = settings.video is VideoKind.LOSSLESS
        self._quality = settings.quality
        self._container: av.container.OutputContainer | None = None
        self._stream: av.VideoStream | None = None
        self._descriptor = -1
        self._times = FrameTimes()

    def write(self, frame: Frame) -> None:
        """Encode a frame and hand it to the file."""
        try:
            if self._container is None or self._stream is None:
                container, stream = self._open(frame)
            else:
                container, stream = self._container, self._stream
            picture = to_picture(frame.image, self._lossless)
            picture.pts, picture.time_base = self._times.of(frame.captured_s), TICK
            container.mux(stream.encode(picture))
        except _FAILURES as error:
            self._give_up()
            raise _failure(error) from error

    def sync(self) -> None:
        """Wait until what was handed to the file is on the disk."""
        if self._descriptor >= 0:
            try:
                os.fdatasync(self._descriptor)
            except OSError as error:
                self._give_up()
                raise _failure(error) from error

    def close(self) -> None:
        """Finish the file: players can then seek in it."""
        container, stream = self._container, self._stream
        if container is None or stream is None:
            return
        try:
            container.mux(stream.encode(None))
            container.close()
        except _FAILURES as error:
            raise _failure(error) from error
        finally:
            self._give_up()

    def _open(self, frame: Frame) -> tuple[av.container.OutputContainer, av.VideoStream]:
        options = {"flush_packets": "1", "cluster_time_limit": _CLUSTER_MS}
        container = av.open(str(self._path), "w", format="matroska", options=options)
        self._container = container
        codec = _LOSSLESS_CODEC if self._lossless else _LOSSY_CODEC
        stream = cast(av.VideoStream, container.add_stream(codec, rate=30, options=self._options()))
        size = frame.width, frame.height
        stream.width, stream.height = size if self._lossless else lossy_size(*size)
        stream.pix_fmt = LOSSLESS_FORMAT if self._lossless else LOSSY_FORMAT
        stream.codec_context.time_base = TICK
        stream.codec_context.thread_count = 1
        container.start_encoding()
        self._stream = stream
        self._descriptor = os.open(self._path, os.O_RDONLY)
        return container, stream

    def _options(self) -> dict[str, str]:
        """No frames out of order and no look-ahead: a killed process loses nothing here."""
        wanted = {"qp": "0"} if self._lossless else {"crf": str(self._quality)}
        return {"preset": "ultrafast", "tune": "zerolatency", "g": _KEY_FRAME_EVERY, **wanted}

    def _give_up(self) -> None:
        container, self._container, self._stream = self._container, None, None
        if container is not None:
            with suppress(*_FAILURES):
                container.close()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _failure(error: Exception) -> VideoFileError:
    number, text = getattr(error, "errno", None), getattr(error, "strerror", None)
    return VideoFileError(number or 0, text or str(error))


def give_way() -> None:
    """Put the calling thread into the scheduler's batch class.

    It then never interrupts another thread when it has something to do, also where the program
    runs with a real-time priority, but keeps its full share when there is time. Where the system
    knows no such class, nothing happens.
    """
    if hasattr(os, "sched_setscheduler"):
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


VIDEO = "video.mkv"
_SYNC_EVERY_S = 0.5


class VideoQueue(ClosesItself):
    """Takes frames without waiting; refuses those for which there is no room.

    Args:
        folder: gets the video.
        settings: see there.
        report: called once each when frames are left out and when the video had to end.
        threaded: False encodes on the caller's thread, which waits: for lockstep.

    Attributes:
        left_out: how many frames are not in the video.
        out_of_room: the video ended because the disk had too little room.
    """

    def __init__(
        self,
        folder: Path,
        settings: RecorderSettings,
        report: Callable[[str], None],
        threaded: bool = True,
    ) -> None:
        self._path = folder / VIDEO
        self._settings = settings
        self._report = report
        self._file = MatroskaWriter(self._path, settings)
        self._changed = threading.Condition()
        self._waiting: deque[Frame] = deque()
        self._waiting_bytes = 0
        self._size: tuple[int, int] | None = None
        self._accepted = 0
        self._ended = settings.video is VideoKind.NONE
        self._closing = False
        self._since_sync = Stopwatch()
        self.left_out = 0
        self.out_of_room = False
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
        """Count a frame that is not in the video, and report the first reason."""
        if self._settings.video is VideoKind.NONE:
            return
        self.left_out += 1
        if self.left_out == 1 and why:
            self._report(f"frames are left out of the video: {why}")

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
            self._end(f"its end could not be written, {failure_said(error, self._path)}", error)
        if self.left_out and not self.out_of_room:
            self._report(f"{self.left_out} frames are not in the video")

    def _refusal(self, frame: Frame) -> str | None:
        """Return why a frame is left out; the first frame decides on the size."""
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
                self._end(failure_said(error, self._path), error)
        with self._changed:
            self._waiting_bytes -= frame.image.nbytes

    def _check_room(self) -> None:
        if is_short_of_room(self._path, self._settings.keep_free_mb):
            self._end(f"the log needs the room that is left ({room_said(self._path)})")
            self.out_of_room = True
            self._file.close()

    def _end(self, why: str, error: OSError | None = None) -> None:
        self.out_of_room = self.out_of_room or (error is not None and is_no_room(error))
        if not self._ended:
            self._report(f"the video ends here: {why}")
        self._ended = True
