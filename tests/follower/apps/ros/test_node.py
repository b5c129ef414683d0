"""The lifecycle node by itself: its parameters, before there is any flight."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, CompressedImage

from follower.apps.ros.conversion import set_stamp
from follower.apps.ros.io_node import SENSOR
from follower.apps.ros.node import FollowerNode, NodeOptions
from follower.apps.ros.topic_source import TopicSource
from follower.flight.status import LiveStatus
from follower.settings.settings import Settings, load_settings
from follower_control.servo.position_fix import TargetPosition

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),  # rclpy's imports
]
PARAMETERS = Path(__file__).parents[4] / "examples/follower-ros/config/follower.yaml"
Made = Callable[..., FollowerNode]


@pytest.fixture
def made(domain: int) -> Iterator[Made]:
    """Give what makes the node with ROS's arguments."""
    with ExitStack() as stack:

        def make(*ros_args: str) -> FollowerNode:
            args = ["follower", "--ros-args", *ros_args]
            off = SignalHandlerOptions.NO
            rclpy.init(args=args, domain_id=domain, signal_handler_options=off)
            stack.callback(rclpy.try_shutdown)
            node = FollowerNode(NodeOptions(), Settings())
            stack.callback(node.close)
            return node

        yield make


def value(node: Any, name: str) -> Any:
    return node.get_parameter(name).value


def failures(node: FollowerNode) -> list[str]:
    """Return what the diagnostics say next."""
    seen = received(node, DiagnosticArray, "/diagnostics", node._diagnose)
    return [one.message for one in seen[-1].status]


def received(node: FollowerNode, kind: type, topic: str, cause: Callable[[], None]) -> list[Any]:
    """Return messages of a topic, the first of which came after `cause`."""
    seen: list[Any] = []
    node.create_subscription(kind, topic, seen.append, 10)
    while not seen:
        cause()
        rclpy.spin_once(node, timeout_sec=0.1)
    return seen


def test_the_file_of_parameters_holds_in_any_namespace(made: Made, tmp_path: Path) -> None:
    changed = tmp_path / "mine.yaml"
    text = PARAMETERS.read_text("utf-8")
    changed.write_text(text.replace("servo.distance_m: 15.0", "servo.distance_m: 22.0"), "utf-8")
    node = made("--params-file", str(changed), "-r", "__ns:=/drone", "-r", "__node:=second")
    assert node.get_fully_qualified_name() == "/drone/second"
    assert value(node, "servo.distance_m") == 22.0


def test_a_mistyped_parameter_refuses_and_is_named(made: Made) -> None:
    node = made("-p", "servo.distanse_m:=5.0", "-p", "use_sim_time:=true")
    assert node.trigger_configure() is TransitionCallbackReturn.FAILURE
    (said,) = failures(node)
    assert said.startswith("cannot configure: no parameters of this node: servo.distanse_m;")


def test_a_parameter_cannot_be_deleted(made: Made) -> None:
    """A flight would begin without it."""
    node = made()
    for active in (False, True):
        node._pursuit = SimpleNamespace() if active else None
        result = node.set_parameters([Parameter("servo.distance_m", Parameter.Type.NOT_SET)])[0]
        assert not result.successful
        assert result.reason == "servo.distance_m: cannot be deleted; set a value, 'null' for none"
    node._pursuit = None
    assert value(node, "servo.distance_m") == 15.0


def test_what_another_changes_in_flight_is_a_parameters_value_and_asked_for_once(
    made: Made,
) -> None:
    node, asked = made(), []
    changed = load_settings(None, None, ("servo.distance_m=9", "servo.target_size_m=1.5"))
    requests = SimpleNamespace(
        settings=changed, change_all=lambda values, _by: asked.append(values) or changed
    )
    flight = SimpleNamespace(requests=requests)
    node._pursuit = SimpleNamespace(flying=True, status=LiveStatus(1.0), flight=flight)
    node._diagnose()
    assert (value(node, "servo.distance_m"), value(node, "servo.target_size_m")) == (9.0, 1.5)
    assert node._outputs.settings is changed
    assert asked == []
    assert node.set_parameters([Parameter("servo.distance_m", value=12.0)])[0].successful
    assert asked == [{"servo.distance_m": 12.0}]
    node._pursuit = None


def test_the_time_cannot_become_anothers_once_topics_are_open(made: Made) -> None:
    node = made()
    assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
    result = node.set_parameters([Parameter("use_sim_time", value=True)])[0]
    assert not result.successful
    assert "use_sim_time: not once configured; clean up first" in result.reason


def test_a_list_set_as_it_was_is_no_override_of_camera_infos_lens(made: Made) -> None:
    node = made()
    zeros = ParameterValue(type=Parameter.Type.DOUBLE_ARRAY.value, double_array_value=[0.0] * 5)
    message = ParameterMessage(name="camera.distortion", value=zeros)
    assert node.set_parameters([Parameter.from_parameter_msg(message)])[0].successful
    k = [500.0, 0, 319.5, 0, 500.0, 239.5, 0, 0, 1]
    node._info.put(CameraInfo(k=k, d=[0.1, 0, 0, 0, 0], width=640, distortion_model="plumb_bob"))
    lens = [one for one in node._overrides() if one.startswith("camera.distortion")]
    assert lens == ["camera.distortion=[0.1, 0.0, 0.0, 0.0, 0.0]"]


def test_diagnostics_are_stamped_before_it_is_active(made: Made) -> None:
    node = made()
    message = received(node, DiagnosticArray, "/diagnostics", node._diagnose)[-1]
    now_s = node.get_clock().now().nanoseconds * 1e-9
    assert 0 <= now_s - message.header.stamp.sec < 10


@pytest.mark.parametrize(
    ("state", "reason", "warns"),
    [
        ("following", "target seen", False),
        ("tracking", "not flying", False),
        ("tracking", "frames stale", True),
        ("holding", "telemetry stale", True),
        ("released", "released, waiting for consent", True),
    ],
)
def test_what_keeps_it_from_following_is_a_warning(
    made: Made, state: str, reason: str, warns: bool
) -> None:
    node, status = made(), LiveStatus(1.0, state=state, reason=reason, track="tracking")

    def show() -> None:
        node._outputs.diagnose(status, "", "direct")

    seen = received(node, DiagnosticArray, "/diagnostics", show)
    shown = next(one for m in seen for one in m.status if one.message == f"{state}: {reason}")
    assert shown.level == (b"\1" if warns else b"\0")


def test_results_are_reliable_as_viewers_want_them(made: Made) -> None:
    node = made()
    for topic in ("track", "roi", "target", "setpoint", "overlay"):
        (told,) = node.get_publishers_info_by_topic(f"/follower/{topic}")
        assert told.qos_profile.reliability is ReliabilityPolicy.RELIABLE, topic


def test_what_is_left_out_is_told_by_the_node_that_has_rosout(
    made: Made, capfd: pytest.CaptureFixture[str]
) -> None:
    node = made()
    assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
    assert node._io is not None
    node._io.left_out("it", ValueError("why"))
    assert "[follower]: it is left out: why" in capfd.readouterr().err


def test_frames_are_the_odometrys_also_where_it_comes_late(made: Made) -> None:
    node = made("-r", "__ns:=/drone")
    assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
    outputs, vehicle = node._outputs, node._vehicle
    assert vehicle is not None
    outputs.clock, outputs.vehicle = node._io.clock, vehicle
    odometry = Odometry(child_frame_id="drone/base_link")
    odometry.header.frame_id = "drone/odom"
    odometry.pose.pose.orientation.w = 1.0
    set_stamp(odometry.header.stamp, outputs.clock.ros_s())
    vehicle._take_odometry(odometry)
    assert vehicle.body_frame == "drone/base_link"
    fix = TargetPosition(outputs.clock.now(), (1.0, 2.0, 3.0), (0.0,) * 3, np.eye(6), 4.0)
    target = "/drone/follower/target"
    seen = received(node, PoseWithCovarianceStamped, target, lambda: outputs._show_target(fix))
    assert seen[-1].header.frame_id == "drone/odom"
    assert outputs._target_frame == "drone/follower_target"


@pytest.mark.parametrize(
    ("remapped", "topic"),
    [
        ("image:=/front/image_raw", "/front/image_raw/compressed"),
        ("image/compressed:=/front/jpeg", "/front/jpeg"),
        ("imu:=/imu", "/image/compressed"),
    ],
)
def test_compressed_images_are_beside_the_raw_ones(made: Made, remapped: str, topic: str) -> None:
    node = made("-r", remapped)
    publisher = node.create_publisher(CompressedImage, topic, SENSOR)
    with TopicSource(node, "image", "compressed") as source:
        assert source.problem == f"no image has come on {topic}"
        while not publisher.get_subscription_count():
            rclpy.spin_once(node, timeout_sec=0.1)
