"""Telemetry from recordings: tlog, PX4's .ulg, ArduPilot's .bin, CSV, DJI's SRT, KLV, GPMF.

Uses: pymavlink, pyulog, PyAV.
Start at: `read_telemetry`, then `samples.TelemetryLog`.
"""

from collections.abc import Callable
from pathlib import Path

from follower.recording.telemetry_logs.container import has_telemetry, read_container
from follower.recording.telemetry_logs.dji import is_drone_srt, read_srt
from follower.recording.telemetry_logs.readers import (
    read_csv,
    read_dataflash,
    read_mavlink,
    read_ulog,
)
from follower.recording.telemetry_logs.samples import (
    TelemetryError,
    TelemetryLog,
    TelemetryPlayback,
    TelemetrySamples,
)

__all__ = [
    "TelemetryError",
    "TelemetryLog",
    "TelemetryPlayback",
    "is_telemetry_log",
    "read_telemetry",
    "telemetry_of_video",
]

_Reader = Callable[[Path], TelemetrySamples]
_READERS: dict[str, _Reader] = {
    ".tlog": read_mavlink,
    ".bin": read_dataflash,
    ".ulg": read_ulog,
    ".csv": read_csv,
    ".srt": read_srt,
}
_BEGINNINGS: tuple[tuple[bytes, _Reader], ...] = (
    (b"\xa3\x95\x80", read_dataflash),
    (b"ULog\x01\x12\x35", read_ulog),
)
_HEAD = 4096


def is_telemetry_log(path: Path) -> bool:
    """Whether a file is telemetry without a video, by its content, else by its ending."""
    return _reader_by_head(path) is not None or path.suffix.lower() in _READERS


def telemetry_of_video(path: Path) -> Path | None:
    """Return where a video's own telemetry is: beside it in an .SRT, or in it; None if nowhere."""
    for name in (path.parent / f"{path.stem}{ending}" for ending in (".SRT", ".srt")):
        if _reader_by_head(name) is read_srt:
            return name
    return path if path.is_file() and has_telemetry(path) else None


def read_telemetry(path: Path) -> TelemetryLog:
    """Read a log; its content, else its ending says of which kind it is.

    Times count from the first attitude, or are those of the video that the log was made with.

    Raises:
        TelemetryError: it is missing, of an unknown kind, broken, or without attitudes.
    """
    reader = _reader_by_head(path) or _READERS.get(path.suffix.lower())
    if reader is None and path.is_file() and has_telemetry(path):
        reader = read_container
    if reader is None:
        raise TelemetryError(
            f"{path}: unknown kind of telemetry log; there are tlog (MAVLink), bin (ArduPilot), "
            "ulg (PX4), csv, srt (DJI), and videos with MISB ST 0601 or GPMF in them"
        )
    if not path.is_file():
        raise TelemetryError(f"{path}: there is no such file; check the path")
    try:
        samples = reader(path)
    except OSError as error:
        raise TelemetryError(f"{path}: cannot be read ({error.strerror or error})") from error
    log = samples.log(str(path))
    return log if log.on_video_clock else log.moved(-log.start_s)


def _reader_by_head(path: Path) -> _Reader | None:
    """Return the reader of a file that begins as only one kind does."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return None
    if is_drone_srt(head.decode("utf-8", "replace")):
        return read_srt
    return next((reader for begin, reader in _BEGINNINGS if head.startswith(begin)), None)
