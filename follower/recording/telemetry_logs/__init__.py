"""Telemetry from log files: tlog, PX4's .ulg, ArduPilot's .bin, CSV.

Uses: pymavlink, pyulog.
Start at: `read_telemetry`, then `samples.TelemetryLog`.
"""

from collections.abc import Callable
from pathlib import Path

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

__all__ = ["TelemetryError", "TelemetryLog", "TelemetryPlayback", "read_telemetry"]

_READERS: dict[str, Callable[[Path], TelemetrySamples]] = {
    ".tlog": read_mavlink,
    ".bin": read_dataflash,
    ".ulg": read_ulog,
    ".csv": read_csv,
}


def read_telemetry(path: Path) -> TelemetryLog:
    """Read a log; its ending says of which kind it is. Times count from the first attitude.

    Raises:
        TelemetryError: it is missing, of an unknown kind, broken, or without attitudes.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise TelemetryError(
            f"{path}: unknown kind of telemetry log; there are tlog (MAVLink), bin (ArduPilot), "
            "ulg (PX4) and csv"
        )
    if not path.is_file():
        raise TelemetryError(f"{path}: there is no such file; check the path")
    try:
        samples = reader(path)
    except OSError as error:
        raise TelemetryError(f"{path}: cannot be read ({error.strerror or error})") from error
    log = samples.log(str(path))
    return log.moved(-log.start_s)
