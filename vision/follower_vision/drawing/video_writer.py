"""Writes H.264 video that browsers and phones play."""

from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import av
import av.container
import av.error
import cv2
import numpy as np

from follower_vision.disk import room_said
from follower_vision.images.frame import Image
from follower_vision.sources.frame_source import ClosesItself

_TICKS_PER_S = 90_000
_FAILURES = (av.error.FFmpegError, OSError, ValueError)


class VideoWriteError(OSError):
    """A video cannot be written; the message says where and what to do."""


class VideoWriter(ClosesItself):
    """Writes frames with their own times into an MP4 file (H.264, yuv420p).

    The file is written in fragments of about a second and put in the usual order by `close`, so
    that it plays even if the process was killed; then its last second may be missing. The file
    is made with the first frame. All frames take the size of the first, made even by repeating
    the last row or column.

    Args:
        path: where to write; its folder has to exist.
        rate_hz: about how many frames a second there will be.

    Attributes:
        path: where the video is.

    Raises:
        VideoWriteError: by `write` and `close`, if the file cannot be made or written.
    """

    def __init__(self, path: str | Path, rate_hz: float = 30.0) -> None:
        if not 0 < rate_hz < float("inf"):
            raise ValueError(f"a video needs a positive rate, not {rate_hz:g}")
        self.path = Path(path)
        self._rate = Fraction(rate_hz).limit_denominator(1000)
        self._container: av.container.OutputContainer | None = None
        self._stream: av.VideoStream | None = None
        self._origin_s = 0.0
        self._last_tick = -1
        self._closed = False

    def write(self, image: Image, captured_s: float) -> None:
        """Add a frame, (H, W, 3) uint8 BGR, to be shown at `captured_s`.

        A time that does not come after the last one is moved just behind it.

        Raises:
            ValueError: the writer is closed.
            VideoWriteError: the file cannot be made or written.
        """
        if self._closed:
            raise ValueError(f"{self.path}: the video is closed")
        try:
            stream = self._stream or self._open(image, captured_s)
            self._encode(stream, self._picture(stream, image, captured_s))
        except _FAILURES as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """Finish the file; it plays from here on. Without frames there is no file."""
        self._closed = True
        if self._container is None or self._stream is None:
            return
        container, stream = self._container, self._stream
        self._container = self._stream = None
        try:
            container.mux(stream.encode(None))
            container.close()
        except _FAILURES as error:
            raise self._failed(error) from error

    def _failed(self, error: Exception) -> VideoWriteError:
        """Give up the file; what is in it already may still play."""
        container, self._container, self._stream = self._container, None, None
        self._closed = True
        if container is not None:
            with suppress(*_FAILURES):
                container.close()
        return VideoWriteError(
            f"cannot write the video: {getattr(error, 'strerror', error)} "
            f"({room_said(self.path)}); check the folder, its permissions and the space left"
        )

    def _open(self, image: Image, captured_s: float) -> av.VideoStream:
        container = av.open(
            str(self.path), "w", format="mp4", options={"movflags": "hybrid_fragmented"}
        )
        # No frames out of order and a short look-ahead: a killed process loses little.
        options = {
            "preset": "veryfast",
            "crf": "23",
            "bf": "0",
            "g": str(max(1, round(self._rate))),
            "rc-lookahead": "5",
        }
        stream = container.add_stream("libx264", rate=self._rate, options=options)
        height, width = image.shape[:2]
        stream.width, stream.height = width + width % 2, height + height % 2
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, _TICKS_PER_S)
        self._container, self._stream, self._origin_s = container, stream, captured_s
        container.start_encoding()
        return stream

    def _picture(self, stream: av.VideoStream, image: Image, captured_s: float) -> av.VideoFrame:
        picture = av.VideoFrame.from_ndarray(
            _fitted(image, stream.width, stream.height), format="bgr24"
        )
        tick = round((captured_s - self._origin_s) * _TICKS_PER_S)
        self._last_tick = max(tick, self._last_tick + 1)
        picture.pts = self._last_tick
        picture.time_base = Fraction(1, _TICKS_PER_S)
        return picture

    def _encode(self, stream: av.VideoStream, picture: av.VideoFrame) -> None:
        if self._container is not None:
            self._container.mux(stream.encode(picture))


def _fitted(image: Image, width: int, height: int) -> Image:
    """Return the image at the video's size: an odd one grown by a pixel, another one resized."""
    right, down = width - image.shape[1], height - image.shape[0]
    if (right, down) == (0, 0):
        return np.ascontiguousarray(image)
    if right in (0, 1) and down in (0, 1):
        grown = cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE)
        return np.asarray(grown, np.uint8)
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
