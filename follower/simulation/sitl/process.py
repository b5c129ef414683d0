"""An autopilot's process: started in a folder of its own, watched, and ended."""

import os
import re
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path

from follower.links.connections import ConnectionFailedError
from follower.simulation.sitl.programs import SitlProgram, SitlSetup
from follower_vision.sources.frame_source import ClosesItself

OUTPUT = "autopilot.txt"
BOOTS_WITHIN_S = 60.0
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_ENDS_WITHIN_S = 10.0
_SHOWN_LINES, _SHOWN_CHARACTERS = 3, 100


class AutopilotProcess(ClosesItself):
    """A program that runs until it is closed.

    It works in a folder that is made for it and removed with it; what it writes to its terminal
    and its own newest log are kept.

    Args:
        program: what is started; `listen` was called.
        setup: how it is started.
        folder: exists already; gets `autopilot.txt` and `autopilot.bin`, `.ulg` or `.csv`.

    Raises:
        ConnectionFailedError: it cannot be started.
    """

    def __init__(self, program: SitlProgram, setup: SitlSetup, folder: Path) -> None:
        self._program = program
        self._output = folder / OUTPUT
        self._work = Path(tempfile.mkdtemp(prefix="follower-sitl-"))
        start = program.start(self._work, setup)
        try:
            with self._output.open("wb") as output:
                self._process = subprocess.Popen(  # noqa: S603  the user's own program
                    start.command,
                    cwd=self._work,
                    env={**os.environ, **start.environment},
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C is for the follower: it holds and releases
                )
        except OSError as error:
            shutil.rmtree(self._work, ignore_errors=True)
            raise ConnectionFailedError(
                f"{start.command[0]} cannot be started: {error.strerror}"
            ) from None

    def close(self) -> None:
        """End it, and keep its log."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        logs = sorted(self._work.glob(self._program.log), key=lambda path: path.stat().st_mtime)
        if logs:
            kept = self._output.with_name(f"autopilot{logs[-1].suffix.lower()}")
            shutil.move(logs[-1], kept)
        shutil.rmtree(self._work, ignore_errors=True)

    @property
    def death(self) -> str:
        """How it ended by itself, "" while it runs."""
        code = self._process.poll()
        if code is None:
            return ""
        how = f"ended with code {code}" if code >= 0 else f"died by {signal.Signals(-code).name}"
        return f"{self._program.title} {how}"

    @property
    def last_lines(self) -> str:
        """The end of what it wrote to its terminal, in one line."""
        lines = self._output.read_text("utf-8", "replace").splitlines()
        plain = [" ".join(_COLOURS.sub("", line).split()) for line in lines]
        said = [line[:_SHOWN_CHARACTERS] for line in plain if line]
        return " / ".join(said[-_SHOWN_LINES:]) or "it wrote nothing"
