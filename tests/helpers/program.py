"""How Python and the command line are run: as programs of their own, or in the test's process."""

import os
import subprocess
import sys
from pathlib import Path

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


def output_of(*arguments: str) -> str:
    """Return what a command writes that succeeds, run in the test's own process."""
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output
