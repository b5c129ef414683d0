"""Telemetry from ArduPilot's own log (.bin), through pymavlink."""

import math
import struct
from pathlib import Path
from typing import Any

from pymavlink import DFReader

from follower.links.modes import mode_name
from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples

_ARDUPILOT = 3
_BEGINNING = b"\xa3\x95\x80"
_KINDS = ["ATT", "IMU", "RATE", "XKF1", "NKF1", "MODE", "ARM"]


def read_dataflash(path: Path) -> TelemetrySamples:
    """Read a .bin: attitude (ATT), gyro (IMU, else RATE), position (XKF1, NKF1), mode (MODE, ARM).

    Raises:
        TelemetryError: it is no such log.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        # pymavlink searches megabytes of anything for a beginning, and leaves the file open.
        if file.read(len(_BEGINNING)) != _BEGINNING:
            raise TelemetryError(f"{path}: this is no ArduPilot log: it begins otherwise")
    try:
        log: Any = DFReader.DFReader_binary(str(path))
    except (ValueError, IndexError, KeyError, struct.error) as error:
        raise TelemetryError(f"{path}: this is no ArduPilot log ({error})") from error
    except Exception as error:
        if type(error) is not Exception:
            raise
        # pymavlink's own complaint about a format that it does not know has no class of its own.
        raise TelemetryError(f"{path}: {error}: damaged, or newer than known here") from error
    samples = TelemetrySamples()
    try:
        _read(log, samples)
    except (AttributeError, struct.error) as error:
        raise TelemetryError(
            f"{path}: a message lacks {error}: the log is damaged, or of a version of ArduPilot "
            f"that is not known here; {len(samples.attitudes)} attitudes before it could be read"
        ) from error
    finally:
        log.close()
    return samples


def _read(log: Any, samples: TelemetrySamples) -> None:
    """Take all messages; of the gyro itself, or of the rates if there is none."""
    rates, armed = list[tuple[float, ...]](), False
    while (message := log.recv_match(type=_KINDS)) is not None:
        kind = message.get_type()
        armed = bool(message.ArmState) if kind == "ARM" else armed
        _take(samples, rates, message, armed)
    if not samples.gyro:
        samples.gyro = rates


def _take(
    samples: TelemetrySamples, rates: list[tuple[float, ...]], message: Any, armed: bool
) -> None:
    time_s = message.TimeUS / 1e6
    m = message
    match message.get_type():
        case "ATT":
            angles = (math.radians(angle) for angle in (m.Roll, m.Pitch, m.Yaw))
            samples.attitudes.append((time_s, *angles))
        case "IMU" if getattr(m, "I", 0) == 0:
            samples.gyro.append((time_s, m.GyrX, m.GyrY, m.GyrZ))
        case "RATE":
            rates.append((time_s, *(math.radians(rate) for rate in (m.R, m.P, m.Y))))
        case "XKF1" | "NKF1" if getattr(m, "C", 0) == 0:
            samples.positions.append((time_s, m.PN, m.PE, m.PD, m.VN, m.VE, m.VD))
        case "MODE":
            samples.add_mode(time_s, mode_name(_ARDUPILOT, m.ModeNum), armed)
