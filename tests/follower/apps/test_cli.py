"""The command line: what goes wrong is told in one line, what is interrupted is complete."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from csv_rows import rows_of
from program import FOLLOWER, MAIN
from small_scenario import small_scenario
from typer.testing import CliRunner

from follower.apps.command_settings import lens_is_given
from follower.apps.main import FAILED, INTERRUPTED, SUCCESS, UNUSABLE, app
from follower.flight.supervision.flight_end import RELEASED_FOR_SAFETY
from follower.recording import open_flight
from follower.settings.settings import load_settings
from follower.simulation.options import SimulationOptions
from follower_vision.sources.open import open_source

RunCommand = Callable[..., Any]


SMALL = small_scenario(60)


@pytest.fixture(scope="module")
def moving_square(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forty pictures of a red square that moves over a textured ground."""
    folder = tmp_path_factory.mktemp("square")
    rng = np.random.default_rng(5)
    ground = cv2.resize(
        rng.integers(60, 180, (24, 32, 3), dtype=np.uint8), (320, 240), interpolation=1
    )
    for number in range(40):
        image = ground.copy()
        x, y = 60 + 3 * number, 100 + number
        cv2.rectangle(image, (x, y), (x + 29, y + 29), (30, 30, 220), -1)
        cv2.rectangle(image, (x + 8, y + 8), (x + 20, y + 14), (200, 200, 40), -1)
        image = cv2.add(image, rng.integers(0, 6, image.shape, dtype=np.uint8))
        cv2.imwrite(str(folder / f"{number:03d}.png"), image)
    return folder


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["track", "nowhere.mp4", "--target", "1,2,3,4"], "nowhere.mp4: there is no such file"),
        (["track", "{square}", "--target", "1000,2,30,30"], "lies outside the image.*320x240"),
        (["track", "{square}", "--target", "1,2,3"], "write x,y,w,h in pixels"),
        (["track", "{square}", "--target", "1,2,-3,4"], "write x,y,w,h in pixels"),
        (["track", "{square}", "--target", "nan,2,3,4"], "write x,y,w,h in pixels"),
        (["track", "{square}"], "which target\\?"),
        (["track", "{square}", "--colour", "reddish"], "reddish"),
        (["track", "{broken}", "--target", "1,2,3,4"], "broken.mp4"),
        (["track", "{square}", "--target", "60,100,30,30", "--set", "servo.kp=1"], "servo.kp"),
        (["sim", "demo", "--link", "foo"], "--link foo: choose pymavlink or mavsdk"),
        (["sim", "nothing"], "there is no scenario 'nothing'.*demo"),
        (["sim", "{mistyped}"], "unknown key 'durations_s'; did you mean 'duration_s'"),
        (["sim", "demo", "--autopilot", "betaflight"], "choose px4 or ardupilot"),
        (["sim", "demo", "--lockstep", "--connect", "tcp:1"], "leave out --connect"),
        (["sim", "demo", "--connect", "tcp:1"], "write udpin:HOST:PORT"),
        (["sim", "demo", "--set", "camera.fov_deg=4000"], "fov_deg lies between 4 and 179"),
        (["sim", "demo", "--config", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["settings", "--set", "servo.distance_m=near"], "servo.distance_m"),
        (["calibrate", "--board", "{broken}/a.pdf"], "^follower: .*/a.pdf: Not a directory$"),
    ],
)
def test_bad_input_ends_in_one_line_and_leaves_nothing(
    arguments: list[str], message: str, run_command: RunCommand, tmp_path: Path, moving_square: Path
) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"this is no video" * 100)
    mistyped = "name: a\ntitle: b\ndurations_s: 3\n"
    (tmp_path / "mistyped.yaml").write_text(mistyped, encoding="utf-8")
    files = {
        "square": str(moving_square),
        "broken": str(tmp_path / "broken.mp4"),
        "mistyped": str(tmp_path / "mistyped.yaml"),
    }
    before = sorted(tmp_path.rglob("*"))
    result = run_command(*(argument.format(**files) for argument in arguments))
    assert result.code == UNUSABLE
    assert result.err.count("\n") == 1
    assert re.search(message, result.err)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["evaluate", "otb", "--trackers", "identity", "--threads", "3000000000"], "--threads"),
        (["trax", "identity", "--threads", "3000000000"], "--threads"),
        (["trax", "identity", "--fps", "inf"], "--fps"),
    ],
)
def test_a_number_outside_its_bounds_is_refused(arguments: list[str], option: str) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == UNUSABLE
    assert f"Invalid value for '{option}'" in result.output


@pytest.mark.slow
def test_a_port_in_use_is_told_before_anything_is_written(
    run_command: RunCommand, tmp_path: Path
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        result = run_command("sim", "demo", "--connect", f"udpin:127.0.0.1:{port}")
    assert result.code == UNUSABLE
    assert re.search(f"udpin:127.0.0.1:{port}: .*in use.*--connect", result.err)
    assert result.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_an_autopilot_that_never_answers_is_not_waited_for_for_ever(
    run_command: RunCommand,
    tmp_path: Path,
    free_port: Callable[[], int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("follower.flight.control.takeoff_monitor._ANSWER_WITHIN_S", 1.0)
    arguments = ("--autopilot", "external", "--connect", f"udpin:127.0.0.1:{free_port()}")
    result = run_command("sim", "demo", *arguments)
    assert result.code == UNUSABLE
    assert "no autopilot answered within 1 s" in result.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "late", "code", "flown"),
    [
        ([], True, FAILED, [False, True]),
        ([], True, RELEASED_FOR_SAFETY, [False, True]),  # the car was not found in time
        ([], True, INTERRUPTED, [False]),
        ([], False, FAILED, [False]),
        (["--lockstep"], False, FAILED, [True]),
        (["--link", "mavsdk"], True, FAILED, [False]),  # which cannot be flown in lockstep
    ],
)
def test_a_demo_that_failed_on_a_slow_computer_is_flown_once_more_in_lockstep(
    run_command: RunCommand,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    late: bool,
    code: int,
    flown: list[bool],
) -> None:
    asked: list[SimulationOptions] = []

    def fly(options: SimulationOptions) -> SimpleNamespace:
        asked.append(options)
        code_now = SUCCESS if options.lockstep else code
        return SimpleNamespace(exit_code=code_now, too_slow=late and not options.lockstep)

    monkeypatch.setattr("follower.simulation.run.simulate", fly)
    result = run_command("demo", *arguments)
    assert [one.lockstep for one in asked] == flown
    assert result.code == (SUCCESS if flown[-1] else code)


@pytest.mark.slow
def test_a_target_can_be_chosen_by_its_colour(
    run_command: RunCommand, tmp_path: Path, moving_square: Path
) -> None:
    result = run_command("track", str(moving_square), "--colour", "#dc1e1e")
    assert result.code == SUCCESS, result.err
    boxes = tmp_path / "runs" / f"track-{moving_square.name}" / "boxes.csv"
    rows = rows_of(boxes)
    assert float(rows[0]["x"]) == pytest.approx(60, abs=4)
    assert rows[-1]["state"] == "tracking"


@pytest.mark.slow
def test_scenarios_and_settings_are_listed(run_command: RunCommand) -> None:
    assert "winding road" in run_command("scenarios").out
    assert "max_yaw_rate_deg_s" in run_command("settings").out
    assert "demo" in run_command("--help").out
    version = subprocess.run([*FOLLOWER, "--version"], capture_output=True, text=True, check=True)
    assert version.stdout.startswith("follower 0.")


def test_a_copy_of_all_settings_describes_no_lens_that_was_not_given(
    run_command: RunCommand, tmp_path: Path
) -> None:
    """Preflight wants the lens from the user; the default field of view is nobody's."""
    copied = tmp_path / "all.yaml"
    copied.write_text(run_command("settings").out, "utf-8")
    assert not lens_is_given(copied)
    assert load_settings(copied) == load_settings()
    copied.write_text(run_command("settings", "--set", "camera.fov_deg=70").out, "utf-8")
    assert lens_is_given(copied)


@pytest.mark.slow
@pytest.mark.parametrize("after", ["arming", "following"])
def test_ctrl_c_holds_and_leaves_a_complete_report_and_a_playable_video(
    tmp_path: Path, after: str
) -> None:
    (tmp_path / "small.yaml").write_text(SMALL, encoding="utf-8")
    process = subprocess.Popen(
        [*FOLLOWER, "sim", "small.yaml"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if after == "arming" or after in line:
            break
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=60)
    assert process.returncode == INTERRUPTED, printed
    folder = tmp_path / "runs" / "small"
    assert "The user ended this flight." in (folder / "report.html").read_text("utf-8")
    assert json.loads((folder / "score.json").read_text("utf-8"))["passed"] is False
    assert count_frames(folder / "overlay.mp4") > 5
    flight = open_flight(folder)
    assert flight.remarks == []
    assert len(list(flight.pictures())) > 5
    assert len(list(flight.packets())) > 50
    rows = rows_of(folder / "setpoints.csv")
    assert rows[-1]["state"] == "released"
    assert float(rows[-1]["forward_m_s"]) == pytest.approx(0.0, abs=0.01)


def count_frames(path: Path) -> int:
    with open_source(str(path)) as source:
        count = 0
        while source.read() is not None:
            count += 1
        assert source.problem is None
        return count


@pytest.mark.slow
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("doc", "doctor"),
        ("prefl", "preflight"),
        ("calibrate la", "latency"),
        ("calibrate --bo", "--board"),
        ("calibrate 0 --bo", "--board"),
        ("calibrate latency --sec", "--seconds"),
    ],
)
def test_a_shell_completes_commands_and_options(typed: str, offered: str, tmp_path: Path) -> None:
    asked = {"_FOLLOWER_COMPLETE": "complete_bash", "COMP_WORDS": f"follower {typed}"}
    asked["COMP_CWORD"] = str(len(typed.split()))
    code = f"import sys; sys.argv = ['follower']; {MAIN}"
    completed = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **asked, "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert completed.stdout.split() == [offered]
