"""`follower ros-demo`: one command flies the simulator and the node, a process each."""

import subprocess
from pathlib import Path

import cv2
import pytest
from program import FOLLOWER

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

from follower import open_flight

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


def test_the_demo_follows_and_leaves_recording_report_and_picture(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    command = [*FOLLOWER, "ros-demo", "--seconds", "5", "--out", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    (folder,) = (tmp_path / "ros-demo").glob("fly*")
    assert any(one.state == "following" for one in open_flight(folder).log.controls)
    picture = cv2.imread(str(folder / "overlay.jpg"))
    assert picture.shape == (480, 640, 3)
    assert (folder / "inspection.html").is_file()
