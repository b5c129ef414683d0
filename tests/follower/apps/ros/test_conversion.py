"""ROS's frames, times and images are ours, and back."""

import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from program import MAIN
from typer.testing import CliRunner

from follower.apps.main import app
from follower.apps.ros.conversion import (
    attitude_of,
    fill_attitude,
    fill_turn,
    flat_settings,
    image_of,
    lens_of,
    set_stamp,
    stamp_s,
    turned_to_body,
    turned_to_world,
)
from follower.settings.settings import Settings
from follower_control.common.strict_config import SettingsError

ROOT = Path(__file__).parents[4]


def test_attitudes_go_there_and_back() -> None:
    for angles in ((0.1, -0.2, 0.3), (-1.0, 0.9, -3.0), (0.0, 0.0, math.pi / 2)):
        q = SimpleNamespace()
        fill_attitude(q, angles)
        assert attitude_of(q) == pytest.approx(angles)
    assert attitude_of(SimpleNamespace(w=math.nan, x=0, y=0, z=0)) is None
    assert attitude_of(SimpleNamespace(w=0, x=0, y=0, z=0)) is None


def test_a_body_that_looks_north_has_its_forward_axis_there() -> None:
    q = SimpleNamespace()
    fill_attitude(q, (0.0, 0.0, 0.0))
    world = turned_to_world(q, SimpleNamespace(x=2.0, y=0.5, z=-1.0))
    assert world == pytest.approx((2.0, -0.5, 1.0))
    assert turned_to_body(q, world) == pytest.approx((2.0, 0.5, -1.0))


def test_a_turn_to_north_east_down_becomes_one_to_east_north_up() -> None:
    """Of a camera (right, down, forward) that looks north: up is its image's top."""
    half = 0.5
    q = SimpleNamespace()
    fill_turn(q, (half, half, half, half))  # right is east, down is down, forward is north
    right = turned_to_world(q, SimpleNamespace(x=1.0, y=0.0, z=0.0))
    forward = turned_to_world(q, SimpleNamespace(x=0.0, y=0.0, z=1.0))
    assert right == pytest.approx((0.0, 1.0, 0.0))
    assert forward == pytest.approx((1.0, 0.0, 0.0))


def test_stamps_keep_their_nanoseconds() -> None:
    stamp = SimpleNamespace(sec=0, nanosec=0)
    set_stamp(stamp, 12.999999999)
    assert (stamp.sec, stamp.nanosec) == (12, 999_999_999)
    assert stamp_s(stamp) == pytest.approx(12.999999999)


def raw(encoding: str, data: np.ndarray, step: int) -> SimpleNamespace:
    height = data.size // step
    return SimpleNamespace(
        encoding=encoding, height=height, width=4, step=step, data=data.tobytes(), header=None
    )


def test_images_come_in_the_usual_encodings_also_with_padded_rows() -> None:
    pixels = np.arange(3 * 16, dtype=np.uint8)
    bgr = image_of(raw("bgr8", pixels, 16))
    assert bgr.shape == (3, 4, 3)
    assert bgr[1, 0].tolist() == [16, 17, 18]
    assert image_of(raw("rgb8", pixels, 16))[1, 0].tolist() == [18, 17, 16]
    assert image_of(raw("mono8", pixels[:12], 4))[0, 2].tolist() == [2, 2, 2]


def test_an_image_of_unknown_kind_or_too_short_is_refused_in_words() -> None:
    with pytest.raises(ValueError, match="16UC1"):
        image_of(raw("16UC1", np.zeros(24, np.uint8), 8))
    broken = raw("bgr8", np.zeros(36, np.uint8), 12)
    broken.height = 9
    with pytest.raises(ValueError, match="too little data"):
        image_of(broken)
    odd = raw("uyvy", np.zeros(36, np.uint8), 6)
    odd.width = 3
    for unreadable in (odd, SimpleNamespace(format="jpeg", data=b"")):
        with pytest.raises(ValueError, match="OpenCV cannot read"):
            image_of(unreadable)


def camera_info(k: list, d: list, model: str = "plumb_bob") -> SimpleNamespace:
    region = SimpleNamespace(width=0, height=0)
    return SimpleNamespace(k=k, d=d, width=640, height=480, distortion_model=model, roi=region)


def test_the_lens_of_camera_info_counts_and_an_uncalibrated_one_does_not() -> None:
    k = [500.0, 0, 319.5, 0, 500.0, 239.5, 0, 0, 1]
    info = camera_info(k, [0.1, 0, 0, 0, 0])
    distortion = (0.1, 0.0, 0.0, 0.0, 0.0)
    lens = {"focal_px": 500.0, "focal_width_px": 640, "center_px": (320.0, 240.0)}
    assert lens_of(info) == {**lens, "distortion": distortion}
    info.roi.width, info.roi.height = 640, 480
    assert lens_of(info)
    info.roi.height = 240
    assert lens_of(info) == {}, "the image is a part of the lens's"
    assert lens_of(camera_info([0.0] * 9, [])) == {}


@pytest.mark.parametrize(
    ("k", "d", "model"),
    [
        ([500.0, 0, 319.5, 0, 450.0, 239.5, 0, 0, 1], [0.0] * 5, "plumb_bob"),
        ([300.0, 0, 319.5, 0, 300.0, 239.5, 0, 0, 1], [0.1] * 4, "equidistant"),
        ([300.0, 0, 319.5, 0, 300.0, 239.5, 0, 0, 1], [0.1] * 8, "rational_polynomial"),
        ([math.nan, 0, 319.5, 0, 300.0, 239.5, 0, 0, 1], [0.0] * 5, "plumb_bob"),
        ([300.0, 0, 319.5, 0, math.nan, 239.5, 0, 0, 1], [0.0] * 5, "plumb_bob"),
        ([300.0, 0, 319.5, 0, 300.0, math.inf, 0, 0, 1], [0.0] * 5, "plumb_bob"),
        ([300.0, 0, 319.5, 0, 300.0, 239.5, 0, 0, 1], [0.0, math.nan, 0, 0, 0], "plumb_bob"),
        ([300.0, 0, 9999.5, 0, 300.0, 239.5, 0, 0, 1], [0.0] * 5, "plumb_bob"),
    ],
)
def test_a_lens_that_ours_cannot_be_does_not_count(k: list, d: list, model: str) -> None:
    """Its lines of sight would be wrong, and the preflight check would say that all is well."""
    info = camera_info(k, d, model)
    assert lens_of(info) == {}


def test_a_mistyped_option_is_no_argument_of_ros() -> None:
    arguments = ["ros", "--confg", "drone.yaml", "--ros-args", "-r", "image:=/camera"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "--confg" in result.output


def test_the_packages_files_are_what_the_settings_and_configs_have() -> None:
    """After a change: python examples/follower-ros/config/make_parameters.py."""
    import yaml

    folder = ROOT / "examples/follower-ros/config"
    profile = (ROOT / "configs/ros/large_images.xml").read_bytes()
    assert (folder / "large_images.xml").read_bytes() == profile
    text = (folder / "follower.yaml").read_text("utf-8")
    assert yaml.safe_load(text)["/**"]["ros__parameters"] == flat_settings(Settings())


def without(package: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command where a package is not installed."""
    missing = f"import sys; sys.modules[{package!r}] = None"
    code = f"{missing}; sys.argv = ['follower', *{arguments!r}]; {MAIN}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["ros", "ros-demo"])
def test_without_ros_it_says_which_extra_to_install(command: str) -> None:
    result = without("rclpy", command)
    assert result.returncode == 2
    assert "pip install -e '.[ros]'" in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "code", "arguments"),
    [
        ("vision_msgs", 1, ("ros", "--detections", "/others", "--activate")),
        ("mavros_msgs", 1, ("ros", "--mode", "mavros", "--activate")),
        ("mavros_msgs", 2, ("ros-demo", "--mode", "mavros")),
    ],
)
def test_without_a_package_of_messages_one_line_names_it(
    package: str, code: int, arguments: tuple[str, ...]
) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")
    result = without(package, *arguments)
    assert result.returncode == code
    assert f"apt install ros-$ROS_DISTRO-{package.replace('_', '-')}" in result.stderr
    assert result.stderr.count("\n") == 1
    assert not result.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", [("-p", "target:=5"), ("--params-file", "nowhere.yaml"), ("-r", "nonsense")]
)
def test_what_ros_does_not_take_is_said_in_one_line(arguments: tuple[str, ...]) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")
    result = without("nothing", "ros", "--ros-args", *arguments)
    assert result.returncode == 2
    (said,) = (line for line in result.stderr.splitlines() if "[rcl]: " not in line)
    assert said.startswith("follower: ROS does not begin, see what follows --ros-args: ")
    assert arguments[1].partition(":")[0] in said


@pytest.mark.slow
def test_without_an_autopilot_each_failed_check_is_named_and_each_reason_said_once(
    free_port: Any,
) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")
    connect = ("--connect", f"udpin:127.0.0.1:{free_port()}")
    result = without("nothing", "ros", "--mode", "direct", *connect, "--activate")
    assert result.returncode == 1
    first, *others = result.stderr.splitlines()
    assert "cannot activate: preflight: " in first
    assert all(line.startswith("  ") and ": " in line for line in others)
    names, why = zip(*(line.strip().split(": ", 1) for line in others), strict=True)
    assert len(", ".join(names).split(", ")) > 10
    assert len(set(why)) == len(why)
    assert max(map(len, (first, *others))) < 400


@pytest.mark.parametrize("mode", ["perception", "sideways"])
def test_the_demo_refuses_modes_in_which_nobody_flies(mode: str) -> None:
    result = CliRunner().invoke(app, ["ros-demo", "--mode", mode])
    assert isinstance(result.exception, SettingsError)
    assert str(result.exception) == f"--mode {mode}: the demo is flown by mavros or direct"
