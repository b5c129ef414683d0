"""Perception alone: tracks and the target's place go out, and nothing ever steers."""

from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, RegionOfInterest
from std_srvs.srv import Trigger

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
REMAPPED = ("imu:=mavros/imu/data", "odometry:=mavros/local_position/odom")


@pytest.fixture(scope="module")
def watched(make_rig) -> Iterator:
    with make_rig() as rig:
        rig.simulator()
        rig.set("simulator", mode="LOITER")
        rig.spin(3.0)
        arguments = [one for name in REMAPPED for one in ("-r", name)]
        transport = ("--image-transport", "compressed")
        rig.follower(*transport, "--activate", "--ros-args", *arguments)
        rig.watch(RegionOfInterest, "/follower/roi")
        rig.watch(DiagnosticArray, "/follower/track")
        rig.watch(PoseWithCovarianceStamped, "/follower/target")
        rig.watch(Image, "/follower/overlay", qos_profile_sensor_data)
        rig.watch(TwistStamped, "/follower/setpoint", qos_profile_sensor_data)
        rig.watch(TwistStamped, "/taken", 50)
        rig.wait(lambda: rig.seen["/follower/target"] and rig.seen["/follower/overlay"])
        yield rig


def test_box_state_probability_and_picture_go_out(watched) -> None:
    track = watched.seen["/follower/track"][-1]
    assert track.status[0].message == "tracking"
    values = {one.key: float(one.value) for one in track.status[0].values}
    assert 0 < values["probability"] <= 1
    assert watched.seen["/follower/roi"][-1].width > 0
    assert track.header.frame_id == "camera"
    assert watched.seen["/follower/overlay"][-1].width == 640


def test_the_targets_place_is_told_in_the_maps_frame_with_its_covariance(watched) -> None:
    """The car stands 20 m north of the vehicle and 3 m east, at the origin of its road."""
    message = watched.seen["/follower/target"][-1]
    place, covariance = message.pose.pose.position, message.pose.covariance
    assert message.header.frame_id == "map"
    assert (place.x, place.y) == pytest.approx((3.0, 20.0), abs=6.0)
    assert abs(place.z) < 2.0
    assert covariance[0] > 0
    assert covariance[7] > 0


def test_messages_of_others_packages_are_used_where_they_are_installed(watched) -> None:
    topics = dict(watched.node.get_topic_names_and_types())
    assert topics["/follower/detection"] == ["vision_msgs/msg/Detection2D"]
    assert topics["/tf"] == ["tf2_msgs/msg/TFMessage"]


def test_a_region_chooses_another_target(watched) -> None:
    publisher = watched.node.create_publisher(RegionOfInterest, "/target_roi", 10)
    wanted = RegionOfInterest(x_offset=50, y_offset=400, width=60, height=50)
    watched.wait(lambda: publisher.get_subscription_count())

    def chosen() -> bool:
        publisher.publish(wanted)
        now = watched.seen["/follower/roi"][-1]
        return abs(now.x_offset - 50) < 30 and abs(now.y_offset - 400) < 30

    watched.wait(chosen)


def test_whatever_the_vehicles_mode_nothing_steers(watched) -> None:
    watched.set("simulator", mode="OFFBOARD")
    watched.spin(3.0)
    assert not watched.seen["/follower/setpoint"]
    assert not watched.seen["/taken"]


def test_without_images_it_says_so(watched) -> None:
    watched.set("simulator", image="ahead")
    watched.wait(lambda: "set the clocks" in watched.state)
    watched.set("simulator", image="")


def test_inactive_it_refuses_what_needs_a_flight_in_words(watched) -> None:
    assert watched.change("deactivate")
    refused = watched.set("follower", mode="direct")
    assert not refused.successful
    assert "clean up first" in refused.reason
    answer = watched.call(Trigger, "/follower/select", Trigger.Request())
    assert not answer.success
    assert "not active" in answer.message
    assert watched.change("cleanup")
    assert watched.set("follower", mode="sideways").successful
    assert not watched.change("configure")
    watched.wait(lambda: "choose one of" in watched.state)
