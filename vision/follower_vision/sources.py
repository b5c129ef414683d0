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
    without_password,
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
    return spec.startswith(_GSTREAMER) or bool(_ADDRESS.match(spec)) or _device(spec) is not None


def open_source(
    spec: str,
    *,
    folder_rate_hz: float = 30.0,
    clock: Clock | None = None,
    live: LiveSettings | None = None,
) -> FrameSource:
    """Open a source of frames.

    Args:
        spec: a video file; a folder of images; a camera ("/dev/video0", or "0" if no file has
            that name); the address of a stream ("rtsp://...", "udp://0.0.0.0:5600" for H.264 in
            MPEG-TS); or "gst:" and a GStreamer pipeline that ends in appsink.
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
    try:
        source.wait_for_first()
    except SourceError as error:
        shown = without_password(spec)
        raise SourceError(str(error) if shown in str(error) else f"{shown}: {error}") from error
    return source


def _connector(spec: str, clock: Clock) -> Callable[[], Connection]:
    """How to connect; what can never work is refused at once."""
    if spec.startswith(_GSTREAMER):
        pipeline = spec.removeprefix(_GSTREAMER).strip()
        check_gstreamer(pipeline)
        return partial(CaptureDevice.gstreamer, pipeline, clock)
    device = _device(spec)
    if device is not None:
        check_device(device)
        return partial(CaptureDevice.v4l2, device, clock)
    return partial(NetworkStream, spec, clock)


def _device(spec: str) -> str | None:
    """Return the path of the camera that is meant, None if it is none."""
    if re.fullmatch(r"\d{1,3}", spec) and not Path(spec).exists():
        return f"/dev/video{int(spec)}"
    return spec if _DEVICE.fullmatch(spec) else None
