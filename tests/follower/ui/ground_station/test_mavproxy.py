"""The module for MAVProxy, in a real MAVProxy, against the follower's camera over UDP."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console as Terminal
from waiting import until

from follower.flight.target.request import ClearSelection, PointSelection
from follower_vision.geometry.box import Box

MODULE = Path(__file__).parents[4] / "examples" / "mavproxy" / "mavproxy_follower.py"
PATIENCE_S = 60.0

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_spec("MAVProxy") is None
        or shutil.which("mavproxy.py", path=Path(sys.executable).parent) is None,
        reason="needs MAVProxy beside this Python: make .venv/dev.stamp",
    ),
]


def with_the_module(folder: Path) -> Path:
    """Return a folder to import MAVProxy from, with our module among its own."""
    spec = find_spec("MAVProxy")
    real, copy = Path(spec.submodule_search_locations[0]), folder / "MAVProxy"
    (copy / "modules").mkdir(parents=True)
    for place, into in ((real, copy), (real / "modules", copy / "modules")):
        for one in place.iterdir():
            if one.name != "modules":
                (into / one.name).symlink_to(one)
    shutil.copy(MODULE, copy / "modules")
    return folder


class Console:
    """MAVProxy's, with the follower's side stepped while it is waited for."""

    def __init__(self, rig: Any, folder: Path) -> None:
        self._rig, self._log, self._read = rig, folder / "console.txt", 0
        self.each_step: Callable[[], None] = lambda: None
        program = Path(sys.executable).parent / "mavproxy.py"
        options = ["--default-modules=link", "--no-state", "--target-system=1"]
        with self._log.open("a") as log:
            self._process = subprocess.Popen(
                [sys.executable, program, f"--master=udpout:127.0.0.1:{rig.port}", *options],
                env={
                    **os.environ,
                    "PYTHONPATH": str(with_the_module(folder)),
                    "PYTHONUNBUFFERED": "1",
                    "HOME": str(folder),
                },
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                text=True,
            )

    def type(self, line: str) -> None:
        with self._log.open("a") as log:  # a terminal shows what is typed; a pipe does not
            log.write(f"MAV>\N{NO-BREAK SPACE}{line}\n")
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def wait(self, pattern: str) -> str:
        """Wait until the console says something new."""
        end_s = time.monotonic() + PATIENCE_S
        while (found := re.search(pattern, self.text()[self._read :])) is None:
            assert time.monotonic() < end_s, self.text()
            assert self._process.poll() is None, self.text()
            self.pass_time()
        self._read += found.end()
        return found[0]

    def status(self) -> str:
        """Return what is said when it is asked for: by what MAVProxy has heard until then."""
        self.type("follower status")
        return self.wait("follower: .*")

    def pass_time(self) -> None:
        self.each_step()
        self._rig.run(0.02)
        time.sleep(0.02)

    def text(self) -> str:
        return self._log.read_text("utf-8", errors="replace")

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@pytest.fixture
def rig(make_rig: Any) -> Any:
    return make_rig()


@pytest.fixture
def console(rig: Any, tmp_path: Path) -> Iterator[Console]:
    with closing(Console(rig, tmp_path)) as console:
        console.wait("Detected vehicle 1:100")
        console.type("module load follower")
        console.wait("Loaded module follower")
        yield console


def test_select_release_and_status_in_a_real_mavproxy(rig: Any, console: Console) -> None:
    console.type("follower select 0.25 0.5 0.75 1.0")
    console.wait("follower: accepted")
    request = rig.requests.take_target()
    assert request.selection.on(640, 480) == Box.from_xywh(160, 240, 320, 240)
    console.type("follower select 0.5 0.25")
    console.wait("follower: accepted")
    assert rig.requests.take_target().selection == PointSelection(0.5, 0.25)
    console.type("follower select 0.5 0.5 0.5001 0.5001")
    console.wait("follower: denied")
    console.type("follower release")
    console.wait("follower: accepted")
    assert rig.requests.take_target().selection == ClearSelection()
    assert rig.requests.take_target() is None


def test_the_status_follows_the_track_and_says_what_was_said(
    rig: Any, console: Console, keep_terminal: Any
) -> None:
    console.type("follower select 0.45 0.45 0.55 0.55")
    console.wait("follower: accepted")
    assert rig.requests.take_target() is not None
    console.each_step = lambda: rig.show(Box(320, 240, 64, 48))
    until(lambda: re.search(r"tracking, box 0\.450 0\.450 0\.550 0\.550", console.status()))
    console.type("follower select 0.5 0.5 0.5001 0.5001")
    console.wait("follower: denied")
    until(lambda: re.search("it said: .*rectangle", console.status()))
    console.type("follower release")
    console.wait("follower: accepted")
    shown = Terminal(record=True, width=100, file=io.StringIO())
    text = console.text()
    text = text[text.index("Detected") :].replace("\nMAV> ", "\n")
    shown.print(text.strip(), highlight=False)
    keep_terminal(shown, "MAVProxy", "mavproxy")


@pytest.mark.parametrize("line", ["", "select 2 0.5", "select a b", "release now", "land"])
def test_what_is_no_command_sends_nothing_and_shows_the_commands(
    rig: Any, console: Console, line: str
) -> None:
    console.type(f"follower {line}")
    console.wait("follower camera NUMBER")
    assert rig.requests.take_target() is None
