"""One open connection to a live camera or stream."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import av
import av.container
import av.error
import cv2
import numpy as np

from follower_vision.clock import Clock
from follower_vision.images.frame import Image
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.video_file import upright

_OPEN_S, _SILENCE_S = 5.0, 2.0
"""For a stream to be reached and recognised; without data for so long it is broken."""
_LOW_DELAY = {
    "fflags": "nobuffer",
    "flags": "low_delay",
    "probesize": "500000",
    "analyzeduration": "500000",
}


class Connection(Protocol):
    """An open camera or stream; when it breaks, another one is made."""

    @property
    def rate_hz(self) -> float | None:
        """Frames a second as the other side declares them; None if it does not."""
        ...

    def images(self) -> Iterator[tuple[Image, float]]:
        """Yield (image, arrival time) as they come; end where the stream ends.

        Raises:
            SourceError: the stream broke or went silent.
        """
        ...

    def close(self) -> None:
        """Release the camera or the socket."""
        ...


class NetworkStream:
    """RTSP, or H.264 in MPEG-TS over UDP, or whatever else FFmpeg opens by an address.

    Args:
        address: e.g. "rtsp://192.168.1.10/live" or "udp://0.0.0.0:5600".
        clock: times the arrival of packets, before they are decoded.

    Raises:
        SourceError: no connection, or no video in it.
    """

    def __init__(self, address: str, clock: Clock) -> None:
        self._shown = without_password(address)
        self._clock = clock
        options = dict(_LOW_DELAY)
        if address.startswith("udp"):
            options["overrun_nonfatal"] = "1"
        if address.startswith("rtsp"):
            options["rtsp_transport"] = "tcp"
        try:
            self._container = av.open(address, options=options, timeout=(_OPEN_S, _SILENCE_S))
        except (av.error.FFmpegError, OSError) as error:
            raise SourceError(
                f"{self._shown}: no stream ({_reason(error)}); is it sending?"
            ) from error
        if not self._container.streams.video:
            self._container.close()
            raise SourceError(f"{self._shown}: there is no video in this stream")
        self._stream = self._container.streams.video[0]
        # Threads that decode several frames at once would give each of them late.
        self._stream.thread_type = "SLICE"

    @property
    def rate_hz(self) -> float | None:
        """The rate that the stream declares."""
        rate = self._stream.average_rate or self._stream.guessed_rate
        return float(rate) if rate else None

    def images(self) -> Iterator[tuple[Image, float]]:
        """Yield decoded pictures; a packet that cannot be decoded (loss on the way) is skipped."""
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets, None)
                arrival_s = self._clock.now()
                pictures = packet.decode() if packet is not None else []
            except av.error.InvalidDataError:
                continue
            except (av.error.FFmpegError, OSError) as error:
                raise SourceError(f"{self._shown}: the stream broke ({_reason(error)})") from error
            if packet is None:
                return
            for picture in pictures:
                yield upright(picture), arrival_s

    def close(self) -> None:
        """Close the connection."""
        self._container.close()


class CaptureDevice:
    """A V4L2 device or a GStreamer pipeline, through OpenCV.

    Raises:
        SourceError: it cannot be opened, or this OpenCV was built without its kind.
    """

    def __init__(self, name: str, capture: cv2.VideoCapture, clock: Clock) -> None:
        self._name = name
        self._capture = capture
        self._clock = clock
        if not capture.isOpened():
            capture.release()
            raise SourceError(
                f"{name}: cannot be opened; is it there, and used by no other program?"
            )
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    @classmethod
    def v4l2(cls, path: str, clock: Clock) -> CaptureDevice:
        """Open a camera such as "/dev/video0"."""
        check_device(path)
        return cls(path, cv2.VideoCapture(path, cv2.CAP_V4L2), clock)

    @classmethod
    def gstreamer(cls, pipeline: str, clock: Clock) -> CaptureDevice:
        """Open a pipeline that ends in `appsink`, if this OpenCV has GStreamer."""
        check_gstreamer(pipeline)
        return cls(f"gst:{pipeline}", cv2.VideoCapture(pipeline, cv2.CAP_GSTREAMER), clock)

    @property
    def rate_hz(self) -> float | None:
        """The rate that the device declares."""
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        return rate if 0 < rate < 1000 else None

    def images(self) -> Iterator[tuple[Image, float]]:
        """Yield pictures until the device gives no more."""
        while True:
            good, image = self._capture.read()
            if not good:
                raise SourceError(f"{self._name}: gives no more pictures; was it unplugged?")
            yield np.asarray(image, np.uint8), self._clock.now()

    def close(self) -> None:
        """Release the device."""
        self._capture.release()


def without_password(address: str) -> str:
    """Return a stream's address as it may be shown: without a name and password in it."""
    return re.sub(r"(?<=://)[^/@]*@", "", address)


def check_device(path: str) -> None:
    """Raise SourceError if there is no such device, or if it may not be used."""
    if not Path(path).exists():
        raise SourceError(f"{path}: there is no such device; `ls /dev/video*` shows them")
    if not os.access(path, os.R_OK | os.W_OK):
        raise SourceError(
            f"{path}: no permission; `sudo usermod -aG video $USER` and a new login give it"
        )


def check_gstreamer(pipeline: str) -> None:
    """Raise SourceError if this OpenCV was built without GStreamer."""
    if re.search(r"GStreamer:\s+YES", cv2.getBuildInformation()) is None:
        raise SourceError(
            f"gst:{pipeline}: this OpenCV has no GStreamer; install a build that has it "
            "(e.g. your system's python3-opencv), or send the stream as RTSP or UDP"
        )


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return "nothing came in time" if "Immediate exit" in text else text
