"""Reads the companion computer's state, where it tells it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from follower.preflight.snapshot import ComputerReading

_ROOT = Path("/")
_ANSWER_S = 2.0
_THROTTLED = "sys/devices/platform/soc/soc:firmware/get_throttled"
_HOTTEST_SENSIBLE_C = 150.0


def read_computer(folder: Path, root: Path = _ROOT) -> ComputerReading:
    """Read everything; what cannot be read is None.

    Args:
        folder: where the recording is to go; it need not exist yet.
        root: stands for "/", where "sys" and "proc" are.
    """
    return ComputerReading(
        free_bytes(folder), str(folder), temperature_c(root), throttled(root), load(root)
    )


def free_bytes(folder: Path) -> int | None:
    """Return the room on a folder's disk, or on that of the folder in which it will be made."""
    for place in (folder, *folder.absolute().parents):
        try:
            return shutil.disk_usage(place).free
        except FileNotFoundError:
            continue
        except OSError:
            return None
    return None


def temperature_c(root: Path = _ROOT) -> float | None:
    """Return the hottest thermal zone's temperature."""
    found = [_number(path) for path in sorted(root.glob("sys/class/thermal/thermal_zone*/temp"))]
    degrees = [number / 1000 for number in found if number is not None]
    return max((d for d in degrees if 0 < d < _HOTTEST_SENSIBLE_C), default=None)


def throttled(root: Path = _ROOT) -> int | None:
    """Return the Raspberry Pi's flags of low voltage and slowing down."""
    try:
        return int((root / _THROTTLED).read_text().strip(), 16)
    except (OSError, ValueError):
        return _asked_of_firmware() if root == _ROOT else None


def load(root: Path = _ROOT) -> float | None:
    """Return the processes that want to run, averaged over a minute, over the cores."""
    try:
        busy = float((root / "proc/loadavg").read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return None
    return busy / (os.cpu_count() or 1)


def _asked_of_firmware() -> int | None:
    program = shutil.which("vcgencmd")
    if program is None:
        return None
    try:
        answer = subprocess.run(  # noqa: S603  found on the path, no user's words in it
            [program, "get_throttled"],
            capture_output=True,
            timeout=_ANSWER_S,
            check=True,
            text=True,
        )
        return int(answer.stdout.strip().partition("=")[2], 16)
    except (OSError, ValueError, subprocess.SubprocessError):
        return None


def _number(path: Path) -> float | None:
    try:
        return float(path.read_text())
    except (OSError, ValueError):
        return None
