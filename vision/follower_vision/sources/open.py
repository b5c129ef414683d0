"""Opens whatever a user names as a source of frames."""

import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from follower_vision.clock import Clock, MonotonicClock
from follower_vision.images.frame import Frame, load_image
from follower_vision.plugins import Plugin
from follower_vision.sources import v4l2
from follower_vision.sources.camera_connection import (
    CaptureDevice,
    Connection,
    Decoder,
    VideoStream,
    check_device,
    check_port,
    rtp_description,
)
from follower_vision.sources.camera_program import PROGRAMS, check_program
from follower_vision.sources.capture import CaptureSettings, without_password
from follower_vision.sources.frame_source import (
    ClosesItself,
    FrameSource,
    SourceError,
)
from follower_vision.sources.live_source import LiveSettings, LiveSource
from follower_vision.sources.plugin_connection import (
    SOURCE_PLUGINS,
    PluginConnection,
    source_errors,
)
from follower_vision.sources.video_file import VideoFile

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp"})
_ADDRESS = re.compile(r"(rtsp|rtsps|rtmp|rtp|udp|tcp|srt|http|https)://", re.IGNORECASE)
_DEVICE = re.compile(r"/dev/(video\d+|v4l/by-(id|path)/.+)")
_ASKED = ("format", "size", "rate_hz", "controls")
"""What only a camera that is read here can be asked for."""
_KIND = re.compile(r"(?P<name>[A-Za-z][\w-]*):")
GIMBALS = {
    "siyi": ("rtsp://192.168.144.25:8554/", "main.264"),
    "topotek": ("rtsp://192.168.144.108:554/", "stream=0"),
    "viewpro": ("rtsp://192.168.2.119:554/", ""),
    "herelink": ("rtsp://192.168.42.1:8554/", "fpv_stream"),
}
"""Gimbal cameras' addresses as they are delivered, and the stream that is meant by default."""


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
            image = load_image(self.paths[index])
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


def pictures_in(folder: Path) -> list[Path]:
    """Return a folder's pictures in natural order, without hidden files.

    A Mac leaves one beside each file on a card or stick: "._2.jpg" is no picture.

    Raises:
        OSError: the folder cannot be read.
    """
    names = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted((path for path in names if path.suffix.lower() in SUFFIXES), key=natural_key)


def _pictures(folder: Path) -> list[Path]:
    if not folder.exists():
        raise SourceError(f"{folder}: there is no such folder; check the path")
    try:
        found = pictures_in(folder)
        if not found and (folder / "img").is_dir():
            found = pictures_in(folder / "img")
    except OSError as error:
        raise SourceError(
            f"{folder}: cannot be read ({error.strerror}); give a folder with read permission"
        ) from error
    if not found:
        raise SourceError(
            f"{folder}: no pictures in this folder; it needs .jpg, .png or .bmp files"
        )
    if all(load_image(path) is None for path in found[:3]):
        raise SourceError(f"{found[0]}: not a readable picture; are the files complete?")
    return found


def is_live(spec: str) -> bool:
    """Return whether `spec` names a camera or a stream rather than a recording."""
    ours = _kind(spec) in (*PROGRAMS, *GIMBALS) or bool(_ADDRESS.match(spec))
    return ours or _device(spec) is not None or _is_sdp(spec) or _plugin(spec) is not None


def open_source(
    spec: str,
    *,
    folder_rate_hz: float = 30.0,
    clock: Clock | None = None,
    live: LiveSettings | None = None,
    capture: CaptureSettings | None = None,
) -> FrameSource:
    """Open a source of frames.

    Args:
        spec: a video file; a folder of images; a camera ("/dev/video0", or "0" if no file has
            that name); the address of a stream ("rtsp://...", "udp://0.0.0.0:5600" for MPEG-TS,
            "rtp://0.0.0.0:5600" for H.264 in RTP) or a session description (.sdp); a kind of
            `PROGRAMS` or `GIMBALS`, ":", and which one; or the name of another package's source,
            ":", and what it makes of the rest.
        folder_rate_hz: frames a second of a folder of images.
        clock: times the frames of live sources; the computer's monotonic clock if None.
        live: how a live source behaves.
        capture: what a camera is asked for.

    Raises:
        SourceError: nothing can be read there; the message says why and what to do.
    """
    if is_live(spec):
        return _open_live(
            spec, clock or MonotonicClock(), live or LiveSettings(), capture or CaptureSettings()
        )
    path = local_path(spec)
    if path.is_dir():
        return ImageFolder(path, folder_rate_hz)
    if _kind(spec):
        kinds = ":, ".join((*PROGRAMS, *GIMBALS, *SOURCE_PLUGINS.names()))
        raise SourceError(
            f"{without_password(spec)}: no such kind of source; there are files, folders, cameras "
            f"(0, /dev/video0), rtsp://, udp://, rtp://, srt://, tcp://, http://, {kinds}:"
        )
    return VideoFile(path)


def local_path(spec: str) -> Path:
    """Return the path of a file or folder, with the home folder for its "~".

    Raises:
        SourceError: no user has that name.
    """
    try:
        return Path(spec).expanduser()
    except RuntimeError as error:
        raise SourceError(f"{spec}: {error}") from None


def _open_live(
    spec: str, clock: Clock, settings: LiveSettings, capture: CaptureSettings
) -> LiveSource:
    source = LiveSource(_connector(spec, clock, capture), clock, settings)
    try:
        source.wait_for_first()
    except SourceError as error:
        shown = without_password(spec)
        raise SourceError(str(error) if shown in str(error) else f"{shown}: {error}") from error
    return source


def _connector(spec: str, clock: Clock, capture: CaptureSettings) -> Callable[[], Connection]:
    """How to connect; what can never work is refused at once."""
    device, kind, where = _device(spec), _kind(spec), spec.partition(":")[2].strip()
    if device is not None:
        check_device(device)
        v4l2.prepare(device, capture)
        return partial(CaptureDevice, device, clock, capture)
    plugin = _plugin(spec)
    if plugin is not None:
        with source_errors(plugin):
            plugin.load()
        return partial(PluginConnection, plugin, where, clock)
    fixed = ("format",) if kind in PROGRAMS and kind != "gst" else _ASKED
    for name in fixed:
        if getattr(capture, name):
            raise SourceError(
                f"{without_password(spec)}: leave camera.capture.{name} out, it is the sender's"
            )
    if scheme := _ADDRESS.match(spec):  # FFmpeg knows protocols by small letters alone
        spec = scheme[0].lower() + spec[scheme.end() :]
    check_port(spec)
    decoder = Decoder(capture.decoder)
    if kind in PROGRAMS:
        check_program(kind)
        return partial(VideoStream.program, kind, where, clock, decoder, capture)
    if kind in GIMBALS:
        address, stream = GIMBALS[kind]
        spec = f"{address}{where or stream}"
    if spec.startswith("rtp:"):
        return partial(VideoStream.sdp, spec, rtp_description(spec), clock, decoder)
    if _is_sdp(spec):
        return partial(
            VideoStream.sdp, spec, Path(spec).read_text("utf-8", "replace"), clock, decoder
        )
    return partial(VideoStream.address, spec, clock, decoder, capture.transport)


def _kind(spec: str) -> str:
    """Return what stands before a colon, "" if nothing does or a file has that name."""
    named = _KIND.match(spec)
    if named is None or _ADDRESS.match(spec) or _exists(spec):
        return ""
    return named["name"]


def _exists(spec: str) -> bool:
    try:
        return Path(spec).exists()
    except (OSError, ValueError):  # as a pipeline that is too long for a file's name
        return False


def _plugin(spec: str) -> Plugin | None:
    """Return the other package's source that is meant, None if it is none."""
    kind = _kind(spec)
    return SOURCE_PLUGINS.find(kind) if kind else None


def _is_sdp(spec: str) -> bool:
    return spec.lower().endswith(".sdp") and _exists(spec) and Path(spec).is_file()


def _device(spec: str) -> str | None:
    """Return the path of the camera that is meant, None if it is none."""
    if re.fullmatch(r"\d{1,3}", spec) and not _exists(spec):
        return f"/dev/video{int(spec)}"
    return spec if _DEVICE.fullmatch(spec) or _DEVICE.fullmatch(_linked(spec)) else None


def _linked(spec: str) -> str:
    """Return where a link leads, such as udev makes for a camera; "" if it is none."""
    try:
        return os.path.realpath(spec) if Path(spec).is_symlink() else ""
    except (OSError, ValueError):  # as a pipeline that is too long for a file's name
        return ""
