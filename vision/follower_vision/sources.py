"""Opens whatever a user names as a source of frames."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from follower_vision.clock import Clock, MonotonicClock
from follower_vision.connection import (
    CaptureDevice,
    Connection,
    NetworkStream,
    check_device,
    check_gstreamer,
)
from follower_vision.framesource import FrameSource, SourceError
from follower_vision.imagefolder import ImageFolder
from follower_vision.live import LiveSettings, LiveSource
from follower_vision.paced import Paced
from follower_vision.videofile import VideoFile

__all__ = [
    "FrameSource",
    "ImageFolder",
    "LiveSettings",
    "LiveSource",
    "Paced",
    "SourceError",
    "VideoFile",
    "is_live",
    "open_source",
]

_ADDRESS = re.compile(r"(rtsp|rtsps|rtmp|udp|tcp|srt|http|https)://", re.IGNORECASE)
_DEVICE = re.compile(r"/dev/video\d+")
_GSTREAMER = "gst:"


def is_live(spec: str) -> bool:
    """Return whether `spec` names a camera or a stream rather than a recording."""
    named = spec.startswith(_GSTREAMER) or _ADDRESS.match(spec) or _DEVICE.fullmatch(spec)
    return bool(named)


def open_source(
    spec: str,
    *,
    folder_rate_hz: float = 30.0,
    clock: Clock | None = None,
    live: LiveSettings | None = None,
) -> FrameSource:
    """Open a source of frames.

    Args:
        spec: a video file; a folder of images; a camera ("/dev/video0"); the address of a stream
            ("rtsp://...", "udp://0.0.0.0:5600" for H.264 in MPEG-TS); or "gst:" and a GStreamer
            pipeline that ends in appsink.
        folder_rate_hz: frames a second of a folder of images.
        clock: times the frames of live sources; the computer's monotonic clock if None.
        live: how a live source behaves.

    Raises:
        SourceError: nothing can be read there; the message says why and what to do.
    """
    if is_live(spec):
        return _open_live(spec, clock or MonotonicClock(), live or LiveSettings())
    path = Path(spec).expanduser()
    if path.is_dir():
        return ImageFolder(path, folder_rate_hz)
    return VideoFile(path)


def _open_live(spec: str, clock: Clock, settings: LiveSettings) -> LiveSource:
    source = LiveSource(_connector(spec, clock), clock, settings)
    source.wait_for_first()
    return source


def _connector(spec: str, clock: Clock) -> Callable[[], Connection]:
    """How to connect; what can never work is refused at once."""
    if spec.startswith(_GSTREAMER):
        pipeline = spec.removeprefix(_GSTREAMER).strip()
        check_gstreamer(pipeline)
        return partial(CaptureDevice.gstreamer, pipeline, clock)
    if _DEVICE.fullmatch(spec):
        check_device(spec)
        return partial(CaptureDevice.v4l2, spec, clock)
    return partial(NetworkStream, spec, clock)
