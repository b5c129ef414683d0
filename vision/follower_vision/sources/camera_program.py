"""Programs that read a camera and write its stream: GStreamer, and rpicam-vid."""

from __future__ import annotations

import os
import re
import select
import shlex
import shutil
import signal
import subprocess
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass

from follower_vision.sources.capture import CaptureSettings, without_password
from follower_vision.sources.frame_source import SourceError

_OPEN_S, _SILENCE_S, _END_S = 15.0, 2.0, 2.0
"""Until the first data, for sensors start slowly; without data it hangs; to end when it is told."""
_APPSINK = re.compile(r"!\s*appsink[^!]*$")
"""The end of a pipeline that is written for OpenCV."""
_GST = "gst-launch-1.0"
_GST_PACKAGES = "gstreamer1.0-tools gstreamer1.0-plugins-base gstreamer1.0-plugins-good"


@dataclass(frozen=True, slots=True)
class ProgramKind:
    """One kind of program.

    Attributes:
        packages: to install where it is missing.
        command: its arguments; {fd} stands for where it writes (stdout if there is none), {where}
            for what follows the kind's name, {width}, {height} and {rate} for what is asked for,
            {controls} for the controls, each made by `control`.
        control: one control, with {name} and {value}.
        default: what {where} is if nothing follows the kind's name.
    """

    packages: str
    command: str
    control: str = "{name}={value}"
    default: str = ""

    def arguments(self, where: str, capture: CaptureSettings, fd: int) -> list[str]:
        """Return the command's words.

        Raises:
            SourceError: they cannot be made of what follows the kind's name.
        """
        width, height = capture.size or (1280, 720)
        controls = " ".join(
            self.control.format(name=name, value=shlex.quote(str(value)))
            for name, value in capture.controls.items()
        )
        asked = {"width": width, "height": height, "rate": round(capture.rate_hz or 30)}
        where = _APPSINK.sub("", where) or self.default
        text = self.command.format(where=where, fd=fd, controls=controls, **asked)
        try:
            return shlex.split(text)
        except ValueError as error:
            raise SourceError(f"{where}: {str(error).lower()}; see the quotes") from None


def _gstreamer(source: str, packages: str = "", default: str = "") -> ProgramKind:
    command = f"{_GST} -q {source} ! matroskamux streamable=true ! fdsink sync=false fd={{fd}}"
    return ProgramKind(f"{_GST_PACKAGES} {packages}".strip(), command, default=default)


_RAW = "video/x-raw,format=I420"
_CAPS = "width={width},height={height},framerate={rate}/1"
PROGRAMS = {
    "gst": _gstreamer("{where}"),
    "libcamera": _gstreamer(
        f"libcamerasrc {{where}} {{controls}} ! video/x-raw,{_CAPS} ! videoconvert ! {_RAW}",
        "gstreamer1.0-libcamera",
    ),
    "argus": _gstreamer(
        "nvarguscamerasrc sensor-id={where} {controls} "
        f"! video/x-raw(memory:NVMM),{_CAPS} ! nvvidconv ! {_RAW}",
        "nvidia-l4t-gstreamer",
        "0",
    ),
    "rpicam": ProgramKind(
        "rpicam-apps",
        "rpicam-vid --camera {where} -t 0 -n -v 0 --width {width} --height {height} "
        "--framerate {rate} {controls} --codec libav --libav-format mpegts --low-latency -o -",
        "--{name} {value}",
        "0",
    ),
}
"""By what stands before the colon. Matroska and MPEG-TS keep the sensor's time stamps."""


class CameraProgram:
    """A running program as a file to read, which ends with the program, or when that is silent.

    Args:
        kind: one of `PROGRAMS`.
        where: which camera, or the pipeline.
        capture: what is asked for.

    Attributes:
        problem: why there is no more to read, with the program's last words; None while there is.

    Raises:
        SourceError: it is not installed, or cannot be started.
    """

    def __init__(self, kind: str, where: str, capture: CaptureSettings) -> None:
        self._kind = PROGRAMS[kind]
        self._fd, writing = os.pipe()
        try:
            check_program(kind)
            arguments = self._kind.arguments(where, capture, writing)
            self._name = arguments[0]
            stdout = subprocess.DEVNULL if "{fd}" in self._kind.command else writing
            self._process = subprocess.Popen(  # noqa: S603 - no shell
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=subprocess.PIPE,
                pass_fds=(writing,),
                text=True,
                errors="replace",
                start_new_session=True,  # with what it starts itself, it is ended by `close`
            )
        except (SourceError, OSError) as error:
            os.close(self._fd)
            raise SourceError(str(error)) from error
        finally:
            os.close(writing)
        self.problem: str | None = None
        self._said: deque[str] = deque(maxlen=20)
        words = self._process.stderr or ()
        self._listener = threading.Thread(target=self._said.extend, args=(words,), daemon=True)
        self._listener.start()
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)
        self._patience_s = _OPEN_S

    def read(self, size: int) -> bytes:
        """Return at most `size` bytes as soon as there are any, none at the end."""
        if not self._poll.poll(1e3 * self._patience_s):
            self.problem = f"{self._name}: no data for {self._patience_s:g} s"
            return b""
        self._patience_s = _SILENCE_S
        data = os.read(self._fd, size)
        if not data:
            self.problem = f"{self._name} ended: {self._last_words()}"
        return data

    def close(self) -> None:
        """End the program."""
        self._signal(signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self._signal(signal.SIGKILL)  # also what it has left behind
        self._process.wait()
        self._listener.join(_END_S)
        if self._process.stderr is not None and not self._listener.is_alive():
            self._process.stderr.close()
        os.close(self._fd)

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    def _last_words(self) -> str:
        self._listener.join(_END_S)
        lines = [line.strip() for line in self._said if line.strip()]
        telling = [line for line in lines if "error" in line.lower()] or lines[-1:]
        words = telling[0] if telling else f"exit code {self._process.poll()}"
        return without_password(f"{words}; it needs {self._kind.packages}")


def check_program(kind: str) -> None:
    """Raise SourceError, which says what to install, where a kind's program is missing."""
    program = shlex.split(PROGRAMS[kind].command)[0]
    if shutil.which(program) is None:
        raise SourceError(
            f"{kind}: {program} is not installed: `sudo apt install {PROGRAMS[kind].packages}`"
        )
