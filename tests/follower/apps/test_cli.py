"""The command line: what goes wrong is told in one line, what is interrupted is complete."""

import csv
import json
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from follower.cli import INTERRUPTED, SUCCESS, UNUSABLE
from follower.recorder import open_flight
from follower_vision.sources import open_source

FOLLOWER = [sys.executable, "-c", "from follower.cli import main; main()"]


def run(*arguments: str, cwd: Path | None = None) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [*FOLLOWER, *arguments], capture_output=True, text=True, timeout=120, cwd=cwd, check=False
    )


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
        (["sim", "demo", "--connect", "tcp:1"], "write udpin:HOST:PORT"),
        (["sim", "demo", "--set", "camera.fov_deg=4000"], "fov_deg lies between 4 and 179"),
        (["sim", "demo", "--config", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["settings", "--set", "servo.distance_m=near"], "servo.distance_m"),
    ],
)
def test_bad_input_ends_in_one_line_and_leaves_nothing(
    arguments: list[str], message: str, tmp_path: Path, moving_square: Path
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
    result = run(*(argument.format(**files) for argument in arguments), cwd=tmp_path)
    assert result.returncode == UNUSABLE
    assert result.stderr.count("\n") == 1
    assert re.search(message, result.stderr)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_port_in_use_is_told_before_anything_is_written(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        result = run("sim", "demo", "--connect", f"udpin:127.0.0.1:{port}", cwd=tmp_path)
    assert result.returncode == UNUSABLE
    assert "in use" in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_an_autopilot_that_never_answers_is_not_waited_for_for_ever(tmp_path: Path) -> None:
    arguments = ("--autopilot", "external", "--connect", f"udpin:127.0.0.1:{free_port()}")
    result = run("sim", "demo", *arguments, cwd=tmp_path)
    assert result.returncode == UNUSABLE
    assert "no autopilot answered within 15 s" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_tracking_a_recording_writes_boxes_setpoints_video_and_plot(
    tmp_path: Path, moving_square: Path
) -> None:
    video, boxes = tmp_path / "out.mp4", tmp_path / "out.csv"
    result = run(
        *("track", str(moving_square), "--target", "60,100,30,30"),
        *("--save", str(video), "--boxes", str(boxes)),
        cwd=tmp_path,
    )
    assert result.returncode == SUCCESS, result.stderr
    rows = rows_of(boxes)
    assert len(rows) == 40
    assert rows[-1]["state"] == "tracking"
    assert float(rows[-1]["x"]) == pytest.approx(60 + 3 * 39, abs=4)
    assert float(rows[-1]["y"]) == pytest.approx(100 + 39, abs=4)
    assert count_frames(video) == 40
    folder = tmp_path / "runs" / f"track-{moving_square.name}"
    assert cv2.imread(str(folder / "track.png")) is not None
    setpoints = rows_of(folder / "setpoints.csv")
    times = [float(row["time"]) for row in setpoints]
    assert np.diff(times) == pytest.approx(0.02, abs=1e-6)


def test_a_target_can_be_chosen_by_its_colour(tmp_path: Path, moving_square: Path) -> None:
    result = run("track", str(moving_square), "--colour", "#dc1e1e", cwd=tmp_path)
    assert result.returncode == SUCCESS, result.stderr
    boxes = tmp_path / "runs" / f"track-{moving_square.name}" / "boxes.csv"
    rows = rows_of(boxes)
    assert float(rows[0]["x"]) == pytest.approx(60, abs=4)
    assert rows[-1]["state"] == "tracking"


def test_scenarios_and_settings_are_listed() -> None:
    assert "winding road" in run("scenarios").stdout
    assert "max_yaw_rate_deg_s" in run("settings").stdout
    assert "demo" in run("--help").stdout
    assert run("--version").stdout.startswith("follower 0.")


@pytest.mark.slow
@pytest.mark.parametrize("after", ["arming", "following"])
def test_ctrl_c_holds_and_leaves_a_complete_report_and_a_playable_video(
    tmp_path: Path, after: str
) -> None:
    process = subprocess.Popen(
        [*FOLLOWER, "sim", "demo", "--connect", f"udpin:127.0.0.1:{free_port()}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
    )
    assert process.stdout is not None
    for line in process.stdout:
        if after == "arming" or after in line:
            break
    time.sleep(3.0)
    process.send_signal(signal.SIGINT)
    printed, _ = process.communicate(timeout=60)
    assert process.returncode == INTERRUPTED, printed
    folder = tmp_path / "runs" / "demo"
    assert "The user ended this flight." in (folder / "report.html").read_text("utf-8")
    assert json.loads((folder / "score.json").read_text("utf-8"))["passed"] is False
    assert count_frames(folder / "overlay.mp4") > 20
    flight = open_flight(folder)
    assert flight.remarks == []
    assert len(list(flight.pictures())) > 20
    assert len(list(flight.packets())) > 100
    rows = rows_of(folder / "setpoints.csv")
    assert rows[-1]["state"] == "released"
    assert float(rows[-1]["forward_m_s"]) == pytest.approx(0.0, abs=0.01)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def count_frames(path: Path) -> int:
    with open_source(str(path)) as source:
        count = 0
        while source.read() is not None:
            count += 1
        assert source.problem is None
        return count
