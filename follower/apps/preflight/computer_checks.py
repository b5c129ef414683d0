"""Checks of the companion computer."""

import os
import shutil
import subprocess
from pathlib import Path

from follower.apps.preflight.check import (
    CheckGroup,
    CompanionSnapshot,
    ComputerReading,
    PreflightFinding,
    failed,
    graded,
    passed,
    unknown,
    warned,
)
from follower.settings.recorder import VideoKind
from follower_vision.disk import can_be_written, free_bytes

COMPUTER = CheckGroup[CompanionSnapshot]("Computer")
_GB = 1e9
_H264, _LOSSLESS = 0.12, 2.0
"""Bytes of video a pixel: the most of seven real sequences, of 0.02 to 0.12 and 0.4 to 1.9."""
_LOG_BYTES_S = 100e3
"""Log and packets: some 50 kB a second at 50 Hz, and as much to spare."""
_USUAL = 1280 * 720 * 30.0
"""Pixels a second where the camera is not known."""
_WARM_C, _HOT_C = 75.0, 85.0
_BUSY, _TOO_BUSY = 0.7, 1.5
_UNDER_VOLTAGE, _THROTTLED = 0x1, 0x2 | 0x4 | 0x8
_SINCE_START = 16
_ROOT = Path("/")
_ANSWER_S = 2.0
_THROTTLED_FILE = "sys/devices/platform/soc/soc:firmware/get_throttled"
_HOTTEST_SENSIBLE_C = 150.0


@COMPUTER.check(
    "disk", "room for the recording of recorder.flight_min; never too little for its log alone"
)
def _disk(s: CompanionSnapshot) -> PreflightFinding:
    free = s.computer.free_bytes
    if not s.computer.writable:
        todo = "see to its rights and whether its disk is read-only, or name another place by --out"
        return failed(f"{s.computer.folder} cannot be written", todo)
    if free is None:
        return unknown(f"the room in {s.computer.folder} cannot be read")
    recorder = s.settings.recorder
    log = 60 * recorder.flight_min * _LOG_BYTES_S
    video = 60 * recorder.flight_min * _video_bytes_s(s)
    needed = log + video + (1e6 * recorder.keep_free_mb if video else 0.0)
    text = (
        f"{free / _GB:.1f} GB free in {s.computer.folder}, {needed / _GB:.1f} GB needed for "
        f"{recorder.flight_min:g} min"
    )
    todo = "delete old runs, name another place by --out, or lower recorder.flight_min"
    return graded(text, todo, good=free >= needed, usable=free >= log)


def _video_bytes_s(s: CompanionSnapshot) -> float:
    """Return how much the video grows in a second, at most."""
    share = {VideoKind.H264: _H264, VideoKind.LOSSLESS: _LOSSLESS, VideoKind.NONE: 0.0}
    size, interval_s = s.camera.size, s.camera.interval_s
    pixels_s = size[0] * size[1] / interval_s if size and interval_s > 0 else _USUAL
    return share[s.settings.recorder.video] * pixels_s


@COMPUTER.check("temperature", "below 75 °C; never above 85 °C", needed=False)
def _temperature(s: CompanionSnapshot) -> PreflightFinding:
    degrees = s.computer.temperature_c
    if degrees is None:
        return unknown("this computer does not report it")
    text = f"{degrees:.0f} °C"
    todo = "cool it: a heat sink, a fan, the propellers' wind"
    return graded(text, todo, good=degrees < _WARM_C, usable=degrees < _HOT_C)


@COMPUTER.check("throttling", "not slowed down, no voltage too low (Raspberry Pi)", needed=False)
def _throttling(s: CompanionSnapshot) -> PreflightFinding:
    flags = s.computer.throttled
    if flags is None:
        return unknown("this computer does not report it")
    now, before = flags & 0xFFFF, flags >> _SINCE_START
    if now & _UNDER_VOLTAGE:
        return failed("the supply's voltage is too low", "a stronger supply, shorter cables")
    if now & _THROTTLED:
        return failed("the processor is slowed down now", "cool it")
    if before & (_UNDER_VOLTAGE | _THROTTLED):
        return warned(
            "it was slowed down or short of voltage since its start", "see to supply, heat"
        )
    return passed("never since its start")


@COMPUTER.check("load", "less than 0.7 running processes a core", needed=False)
def _load(s: CompanionSnapshot) -> PreflightFinding:
    share = s.computer.load
    if share is None:
        return unknown("this computer does not report it")
    text = f"load {share:.2f} a core"
    return graded(text, "end other programs", good=share < _BUSY, usable=share < _TOO_BUSY)


def read_computer(folder: Path) -> ComputerReading:
    """Read everything; what cannot be read is None.

    Args:
        folder: where the recording is to go; it need not exist yet.
    """
    return ComputerReading(
        free_bytes(folder),
        str(folder),
        temperature_c(),
        throttled(),
        load_per_core(),
        can_be_written(folder),
    )


def temperature_c(root: Path = _ROOT) -> float | None:
    """Return the hottest thermal zone's temperature."""
    found = [_number(path) for path in sorted(root.glob("sys/class/thermal/thermal_zone*/temp"))]
    degrees = [number / 1000 for number in found if number is not None]
    return max((d for d in degrees if 0 < d < _HOTTEST_SENSIBLE_C), default=None)


def throttled(root: Path = _ROOT) -> int | None:
    """Return the Raspberry Pi's flags of low voltage and slowing down."""
    try:
        return int((root / _THROTTLED_FILE).read_text().strip(), 16)
    except (OSError, ValueError):
        return _asked_of_firmware() if root == _ROOT else None


def load_per_core(root: Path = _ROOT) -> float | None:
    """Return the processes that want to run, averaged over a minute, over the cores."""
    busy = _number(root / "proc/loadavg")
    return None if busy is None else busy / (os.cpu_count() or 1)


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
    """Return the first number in a file, None if there is none."""
    try:
        return float(path.read_text().split()[0])
    except (OSError, ValueError, IndexError):
        return None
