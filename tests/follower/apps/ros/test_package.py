"""The package in examples/follower-ros: colcon builds it, and `ros2` runs and launches its node."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
PACKAGE = Path(__file__).parents[4] / "examples" / "follower-ros"
PATIENCE_S = 200


def program(name: str, why: str) -> str:
    """Return a program beside this Python, or of the path; what needs it is skipped without."""
    place = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    found = shutil.which(name, path=place)
    return found or pytest.skip(f"{name} is not here: {why}")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a workspace that colcon has built."""
    colcon = program("colcon", "pip install colcon-ros")
    folder = tmp_path_factory.mktemp("workspace")
    shutil.copytree(PACKAGE, folder / "src" / "follower_ros")
    built = subprocess.run(
        [colcon, "build"], cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


def sourced(workspace: Path, command: str) -> subprocess.CompletedProcess[str]:
    """Run a command where the workspace is sourced, as a user does."""
    return subprocess.run(
        ["sh", "-c", f". ./install/local_setup.sh && exec {command}"],
        cwd=workspace,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


def test_ros_finds_the_package_its_launch_file_and_its_parameters(workspace: Path) -> None:
    code = "import ament_index_python as a; print(a.get_package_share_directory('follower_ros'))"
    found = sourced(workspace, f'{sys.executable} -c "{code}"')
    share = Path(found.stdout.strip())
    assert share == workspace / "install" / "follower_ros" / "share" / "follower_ros", found.stderr
    for name in ("package.xml", "launch/follower.launch.py", "config/follower.yaml"):
        assert (share / name).is_file()


def test_its_executable_is_the_node_and_hands_on_options_and_ros_args(workspace: Path) -> None:
    executable = "install/follower_ros/lib/follower_ros/follower"
    arguments = "--activate --ros-args -p mode:=sideways -r __ns:=/drone"
    ended = sourced(workspace, f"{executable} {arguments}")
    assert ended.returncode == 1
    assert "[drone.follower]: cannot configure: mode 'sideways': choose one of" in ended.stderr


def test_ros2_launch_starts_the_node_configures_it_and_hands_on_its_arguments(
    workspace: Path,
) -> None:
    """Without images it cannot be activated, and says so under the name that was remapped."""
    ros2 = program("ros2", "source a set-up of ROS 2 with ros2launch")
    launch = f"{ros2} launch follower_ros follower.launch.py image:=/front"
    said = ""
    with subprocess.Popen(
        ["sh", "-c", f". ./install/local_setup.sh && exec {launch}"],
        cwd=workspace,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        watchdog = threading.Timer(PATIENCE_S, process.kill)
        watchdog.start()
        for line in process.stdout:
            said += line
            if "cannot activate" in line:
                break
        process.send_signal(signal.SIGINT)
        said += process.stdout.read()
        watchdog.cancel()
    assert "[follower]: cannot activate: " in said
    assert "no image has come on /front" in said
