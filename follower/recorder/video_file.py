"""Writes `video.mkv`: the frames that vision saw, playable up to a killed process's last second."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import cast

import av
import av.container
import av.error

from follower.recorder.pictures import (
    LOSSLESS_FORMAT,
    LOSSY_FORMAT,
    TICK,
    PictureTimes,
    lossy_size,
    to_picture,
)
from follower.recorder_settings import RecorderSettings, VideoKind
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself

_LOSSLESS_CODEC, _LOSSY_CODEC = "libx264rgb", "libx264"
_CLUSTER_MS = "400"
_KEY_FRAME_EVERY = "30"
_FAILURES = (av.error.FFmpegError, OSError, ValueError)
"""A codec that this FFmpeg lacks is a ValueError of PyAV's."""


class VideoFileError(OSError):
    """The video cannot be written; the message says why in a few words."""


class VideoFile(ClosesItself):
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
        self._times = PictureTimes()

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
