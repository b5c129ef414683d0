"""Opens whatever a user names as a source of frames."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from follower_vision.clock import Clock, MonotonicClock
from follower_vision.images.frame import Frame, Image
from follower_vision.plugins import Plugin
from follower_vision.sources.camera_connection import (
    CaptureDevice,
    Connection,
    NetworkStream,
    check_device,
    check_gstreamer,
    without_password,
)
from follower_vision.sources.frame_source import (
    ClosesItself,
    FrameSource,
    RealtimePlayback,
    SourceError,
)
from follower_vision.sources.live_source import LiveSettings, LiveSource
from follower_vision.sources.plugin_connection import (
    SOURCE_PLUGINS,
    PluginConnection,
    source_errors,
)
from follower_vision.sources.video_file import VideoFile

__all__ = [
    "FrameSource",
    "ImageFolder",
    "LiveSettings",
    "LiveSource",
    "RealtimePlayback",
    "SourceError",
    "VideoFile",
    "is_live",
    "open_source",
]

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp"})
_ADDRESS = re.compile(r"(rtsp|rtsps|rtmp|udp|tcp|srt|http|https)://", re.IGNORECASE)
_DEVICE = re.compile(r"/dev/video\d+")
_GSTREAMER = "gst:"
_PLUGIN = re.compile(r"(?P<name>[A-Za-z][\w-]*):")


class ImageFolder(ClosesItself):
    """Reads the pictures of a folder in natural order (2.jpg before 10.jpg) at a given rate.

    A folder without pictures but with a folder `img` in it, as most data sets have, stands for
    that one. A picture that cannot be decoded leaves a gap in the sequence numbers and a word in
    `problem`.

    Args:
        path: the folder.
        rate_hz: frames a second: picture i was taken at i / rate_hz seconds.

    Attributes:
        nominal_rate_hz: the rate given.
        paths: the pictures in order.
        frame_count: how many there are.

    Raises:
        SourceError: the folder is missing, unreadable or without pictures, or the rate is not
            positive.
    """

    def __init__(self, path: str | Path, rate_hz: float = 30.0) -> None:
        if not 0 < rate_hz < float("inf"):
            raise SourceError(f"{path}: a folder of images needs a positive rate, not {rate_hz:g}")
        self.nominal_rate_hz = rate_hz
        self.paths = _pictures(Path(path))
        self.frame_count = len(self.paths)
        self._next = 0
        self._broken: list[Path] = []

    @property
    def problem(self) -> str | None:
        """Names the first picture that could not be decoded; None if there was none so far."""
        if not self._broken:
            return None
        return f"{self._broken[0]}: not a readable picture ({len(self._broken)} such were skipped)"

    def read(self) -> Frame | None:
        """Return the next picture that can be decoded, or None at the end."""
        while self._next < len(self.paths):
            index, self._next = self._next, self._next + 1
            image = _load(self.paths[index])
            if image is not None:
                return Frame(image, index / self.nominal_rate_hz, index)
            self._broken.append(self.paths[index])
        return None

    def close(self) -> None:
        """Forget the pictures that are left."""
        self._next = len(self.paths)


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a sorting key by which numbers in a file's name count as numbers."""
    parts = re.split(r"(\d+)", path.name.lower())
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part)


def _pictures(folder: Path) -> list[Path]:
    if not folder.exists():
        raise SourceError(f"{folder}: there is no such folder; check the path")
    found = _suitable(folder)
    if not found and (folder / "img").is_dir():
        found = _suitable(folder / "img")
    if not found:
        raise SourceError(
            f"{folder}: no pictures in this folder; it needs .jpg, .png or .bmp files"
        )
    if all(_load(path) is None for path in found[:3]):
        raise SourceError(f"{found[0]}: not a readable picture; are the files complete?")
    return found


def _suitable(folder: Path) -> list[Path]:
    try:
        entries = list(folder.iterdir())
    except OSError as error:
        raise SourceError(
            f"{folder}: cannot be read ({error.strerror}); give a folder with read permission"
        ) from error
    return sorted((p for p in entries if p.suffix.lower() in SUFFIXES), key=natural_key)


def _load(path: Path) -> Image | None:
    try:
        data = np.fromfile(path, np.uint8)
    except OSError:
        return None
    if not data.size:
        return None
    image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return None if image is None else np.asarray(image, np.uint8)


def is_live(spec: str) -> bool:
    """Return whether `spec` names a camera or a stream rather than a recording."""
    ours = spec.startswith(_GSTREAMER) or bool(_ADDRESS.match(spec)) or _device(spec) is not None
    return ours or _plugin(spec) is not None


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
            MPEG-TS); "gst:" and a GStreamer pipeline that ends in appsink; or the name of another
            package's source, ":", and what it makes of the rest.
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
    plugin = _plugin(spec)
    if plugin is not None:
        with source_errors(plugin):
            plugin.load()
        return partial(PluginConnection, plugin, spec.partition(":")[2], clock)
    return partial(NetworkStream, spec, clock)


def _plugin(spec: str) -> Plugin | None:
    """Return the other package's source that is meant, None if it is none."""
    named = _PLUGIN.match(spec)
    if named is None or _ADDRESS.match(spec) or Path(spec).exists():
        return None
    return SOURCE_PLUGINS.find(named["name"])


def _device(spec: str) -> str | None:
    """Return the path of the camera that is meant, None if it is none."""
    if re.fullmatch(r"\d{1,3}", spec) and not Path(spec).exists():
        return f"/dev/video{int(spec)}"
    return spec if _DEVICE.fullmatch(spec) else None
