"""How Python and the command line are run: as programs of their own, or in the test's process."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from follower.apps.main import app

ROOT = Path(__file__).parents[2]
MAIN = "from follower.apps.main import main; main()"
FOLLOWER = (sys.executable, "-c", MAIN)


def run_from(
    sources: Path,
    *arguments: str,
    cwd: Path,
    site: tuple[Path, ...] = (),
    codes: tuple[int, ...] = (0,),
) -> subprocess.CompletedProcess[str]:
    """Run Python where it finds what is installed in `site`, and then these sources' packages."""
    places = (*site, *(sources / name for name in (".", "vision", "control", "sim")))
    ran = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, places)), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert ran.returncode in codes, ran.stdout + ran.stderr
    return ran


def python(code: str) -> str:
    """Return what lines of Python print in a process of their own, at the repository's root."""
    command = [sys.executable, "-c", code]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    return ran.stdout.strip()


def kept_by_importing(module: str, home: Path) -> list[Path]:
    """Return what a process of its own, with this folder as its home, leaves there."""
    at_home = {**os.environ, "HOME": str(home), "XDG_CACHE_HOME": str(home)}
    at_home.pop("ORT_DISABLE_TELEMETRY", None)
    subprocess.run([sys.executable, "-c", f"import {module}"], cwd=ROOT, env=at_home, check=True)
    return list(home.iterdir())


def output_of(*arguments: str) -> str:
    """Return what a command writes that succeeds, run in the test's own process."""
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


class RunningProgram:
    """The command line in a process of its own, and what it has said so far.

    Attributes:
        said: by standard output and error.
        deaf: set, its next line is the last one that is read: the pipe breaks.
    """

    def __init__(self, *arguments: str, cwd: Path, **environment: str) -> None:
        self.said = ""
        self.deaf = threading.Event()
        self.process = subprocess.Popen(
            [*FOLLOWER, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
            cwd=cwd,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "200", **environment},
        )
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def wait(self, condition: Callable[[], Any], within_s: float = 90.0) -> Any:
        """Return what comes about while the program runs."""
        end_s, runs = time.monotonic() + within_s, True
        while runs and time.monotonic() < end_s:
            runs = self.process.poll() is None
            if found := condition():
                return found
            time.sleep(0.05)
        raise AssertionError(f"waited in vain; it said:\n{self.said}")

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Return where it said something like this."""
        return self.wait(lambda: re.search(pattern, self.said))

    def end(self, how: signal.Signals | None = None) -> int:
        """Return its exit code, once it has ended and all that it said is there."""
        if how is not None:
            self.process.send_signal(how)
        self.process.wait(60)
        self.reader.join(10)
        return self.process.returncode

    def close(self) -> None:
        self.process.kill()
        self.end()

    def _read(self) -> None:
        with self.process.stdout as stream:
            for line in stream:
                self.said += line
                if self.deaf.is_set():
                    return
