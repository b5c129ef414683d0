"""A recorded flight becomes a bag that others open, and a bag becomes a flight again."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="rosbags is not here: pip install -e .[ros]")

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from follower import open_flight, simulate
from follower.apps.ros.bag import CLIP, TABLE, pack, unpack
from follower.recording.telemetry_logs import read_telemetry
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.video_file import VideoFile

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = ["duration_s=14", "camera.rate_hz=10"]
    out = tmp_path_factory.mktemp("runs")
    return simulate("winding", scene=scene, overrides=["detector=null"], out=out).folder


@pytest.fixture(scope="module")
def bag(flight: Path) -> Path:
    return pack(flight, flight / "bag")


def test_the_bag_is_mcap_with_the_schemas_of_ros(flight: Path, bag: Path) -> None:
    with (bag / "bag.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert {one.name for one in summary.schemas.values()} >= {
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Imu",
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/TwistStamped",
        "diagnostic_msgs/msg/DiagnosticArray",
    }
    assert {one.message_encoding for one in summary.channels.values()} == {"cdr"}
    recorded = open_flight(flight)
    with AnyReader([bag]) as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
    assert counts["/image/compressed"] == len(recorded.frames)
    assert counts["/follower/setpoint"] == sum(one.sent for one in recorded.log.controls)


def test_what_comes_back_is_what_was_flown(flight: Path, bag: Path, tmp_path: Path) -> None:
    words = unpack(bag, tmp_path)
    assert words.startswith("follower import")
    recorded = open_flight(flight)
    log = read_telemetry(tmp_path / TABLE)
    flown = [one for record in recorded.log.controls for one in record.attitudes]
    assert len(log.attitudes) == pytest.approx(len(flown), abs=2)
    assert log.attitudes[-1].yaw_rad == pytest.approx(flown[-1].yaw_rad, abs=1e-6)
    assert log.positions[-1].down_m == pytest.approx(
        recorded.log.controls[-1].vehicle.position.down_m, abs=0.2
    )
    with VideoFile(tmp_path / CLIP) as video:
        frames = 0
        while video.read() is not None:
            frames += 1
    assert frames == len(recorded.frames)


def test_what_is_no_bag_or_exists_already_is_refused(flight: Path, bag: Path) -> None:
    with pytest.raises(SourceError, match="exists already"):
        pack(flight, bag)
    (flight / "broken").mkdir()
    (flight / "broken" / "metadata.yaml").write_text("no: bag")
    command = [sys.executable, "-c", "from follower.apps.main import main; main()"]
    result = subprocess.run(
        [*command, "ros-bag", str(flight / "broken")], capture_output=True, text=True
    )
    assert result.returncode == 2
    assert "cannot be read as a bag" in result.stderr
