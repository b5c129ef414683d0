"""Reads a telemetry log of any of the kinds known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from follower.telemetry.csvlog import read_csv
from follower.telemetry.dataflash import read_dataflash
from follower.telemetry.log import Samples, TelemetryError, TelemetryLog
from follower.telemetry.mavlinklog import read_mavlink
from follower.telemetry.ulog import read_ulog

READERS: dict[str, Callable[[Path], Samples]] = {
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
    reader = READERS.get(path.suffix.lower())
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
    return samples.log(str(path)).from_its_start()
