"""Frames from a video file, with the times at which they are to be shown."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import av
import av.container
import av.error
import cv2
import numpy as np

from follower_vision.images.frame import Frame, Image
from follower_vision.sources.frame_source import ClosesItself, SourceError

_FALLBACK_RATE_HZ = 30.0
_TURNS = {
    90: cv2.ROTATE_90_COUNTERCLOCKWISE,
    180: cv2.ROTATE_180,
    270: cv2.ROTATE_90_CLOCKWISE,
}
_NOT_VIDEO = {"tty", "bin", "xbin", "adf", "idf"}
"""Formats by which FFmpeg draws any text or binary file as a picture of characters."""


class VideoFile(ClosesItself):
    """Reads a video file from its beginning to its end, or to where it is broken.

    `captured_s` is the frame's presentation time, counted from the first frame. Pictures that a
    phone stored turned are turned upright. Damaged parts are skipped, or as FFmpeg patches them up;
    `problem` then says so.

    Attributes:
        nominal_rate_hz: the file's average frame rate.
        frame_count: how many frames the file declares; None if it does not.
        duration_s: how long the file says that it is; None if it does not say.

    Raises:
        SourceError: the file is missing, empty, unreadable or holds no video.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        _check_file(self._path)
        self._container = _open(self._path)
        self._stream = _video_stream(self._container, self._path)
        self._stream.thread_type = "AUTO"
        # What the file declares is read now: after `close` PyAV does not give it any more.
        self.frame_count = self._stream.frames or None
        self.duration_s = _declared_s(self._container, self._stream)
        self.nominal_rate_hz = float(
            self._stream.average_rate or self._stream.guessed_rate or _FALLBACK_RATE_HZ
        )
        self._damaged = 0
        self._last_s = 0.0
        self._origin_s: float | None = None
        self._start_s = _counts_from_s(self._stream)
        self._ended = False
        self._sequence = 0
        self._frames = self._decode()
        self._first = self._require_first()

    @property
    def problem(self) -> str | None:
        """Says what is broken in the file, as far as it was read; None if nothing."""
        due_s = self.duration_s
        slack_s = 2 / self.nominal_rate_hz
        # A recording may begin late, or underway: it cannot be shown before its first key frame.
        hidden_s = max(self.origin_s - self._start_s, 0.0)
        end_s = hidden_s + self._last_s
        if self._ended and due_s is not None and end_s < 0.95 * due_s - slack_s:
            return (
                f"{self._path}: it ends at {end_s:.2f} s, though it says that it is "
                f"{due_s:.2f} s long; the file was cut short, copy it anew"
            )
        if self._damaged:
            return f"{self._path}: damaged in {self._damaged} of its packets; copy the file anew"
        return None

    @property
    def origin_s(self) -> float:
        """The first frame's presentation time, from which `captured_s` counts."""
        return self._origin_s or 0.0

    def read(self) -> Frame | None:
        """Return the next frame, or None at the end."""
        if self._first is not None:
            frame, self._first = self._first, None
            return frame
        return next(self._frames, None)

    def close(self) -> None:
        """Close the file."""
        self._first = None
        self._frames.close()
        self._container.close()

    def _require_first(self) -> Frame | None:
        first = next(self._frames, None)
        if first is None:
            self.close()
            raise SourceError(f"{self._path}: no frame can be decoded; is the file complete?")
        return first

    def _decode(self) -> Generator[Frame, None, None]:
        for picture in self._pictures():
            yield self._frame(picture)
        self._ended = True

    def _pictures(self) -> Iterator[av.VideoFrame]:
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next_packet(packets)
                if packet is None:
                    return
                pictures = packet.decode()
                self._damaged += packet.is_corrupt or any(one.is_corrupt for one in pictures)
                yield from pictures
            except av.error.InvalidDataError:
                self._damaged += 1
            except av.error.FFmpegError:
                self._damaged += 1
                return

    def _frame(self, picture: av.VideoFrame) -> Frame:
        time_s = self._time_s(picture)
        frame = Frame(upright(picture), time_s, self._sequence)
        self._sequence += 1
        self._last_s = time_s
        return frame

    def _time_s(self, picture: av.VideoFrame) -> float:
        """Time since the first frame; times that stand still or are missing move on."""
        shown_s, time_s = picture.time, self._last_s
        if shown_s is not None:
            if self._origin_s is None:
                self._origin_s = shown_s - self._last_s
            time_s = shown_s - self._origin_s
        if self._sequence and time_s <= self._last_s:
            return self._last_s + 1 / self.nominal_rate_hz
        return time_s


def next_packet(packets: Iterator[av.Packet[Any]]) -> av.Packet[Any] | None:
    """Return what PyAV demuxes next, None at the end."""
    try:
        return next(packets, None)
    except IndexError:  # at the end it also flushes a stream that began underway, unknown to it
        return None


def upright(picture: av.VideoFrame) -> Image:
    """Return a decoded picture as (H, W, 3) BGR, turned as its display matrix says."""
    image = np.asarray(picture.to_ndarray(format="bgr24"), np.uint8)
    turn = _TURNS.get(round(picture.rotation / 90) * 90 % 360)
    return image if turn is None else np.asarray(cv2.rotate(image, turn), np.uint8)


def _check_file(path: Path) -> None:
    if not path.exists():
        raise SourceError(f"{path}: there is no such file; check the path")
    if not path.is_file():
        raise SourceError(f"{path}: this is not a file; give a video file or a folder of images")
    try:
        empty = path.stat().st_size == 0
        path.open("rb").close()
    except OSError as error:
        raise SourceError(
            f"{path}: cannot be read ({error.strerror}); check its permissions"
        ) from error
    if empty:
        raise SourceError(f"{path}: the file is empty; copy it anew")


def _open(path: Path) -> av.container.InputContainer:
    try:
        container = av.open(str(path), metadata_errors="replace")
    except av.error.FFmpegError as error:
        raise SourceError(
            f"{path}: not a video that FFmpeg can open ({error.strerror}); "
            "give an MP4, MKV, AVI, MOV or TS file that is complete"
        ) from error
    if container.format.name in _NOT_VIDEO:
        container.close()
        raise SourceError(f"{path}: not a video; give an MP4, MKV, AVI, MOV or TS file")
    return container


def _video_stream(container: av.container.InputContainer, path: Path) -> av.VideoStream:
    if not container.streams.video:
        container.close()
        raise SourceError(f"{path}: there is no video in this file, only audio or data")
    return container.streams.video[0]


def _counts_from_s(stream: av.VideoStream) -> float:
    """Return from when on the declared duration counts; a whole file's counts from 0, as in MKV."""
    if stream.duration is None or stream.time_base is None:
        return 0.0
    return float((stream.start_time or 0) * stream.time_base)


def _declared_s(container: av.container.InputContainer, stream: av.VideoStream) -> float | None:
    if stream.duration is not None and stream.time_base is not None:
        return float(stream.duration * stream.time_base)
    return None if container.duration is None else container.duration / av.time_base
