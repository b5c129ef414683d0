"""Perception alone: tracks and the target's place go out, and nothing ever steers."""

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, RegionOfInterest
from std_srvs.srv import Trigger

from follower import open_flight, replay

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
        others = ("--detections", "/others", "--set", "recorder.video=lossless")
        rig.follower(*transport, *others, "--activate", "--ros-args", *arguments)
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


def chosen(rig, publisher, message, x: float, y: float) -> None:
    """Have a message sent until the box that is tracked is at x, y in pixels."""
    rig.wait(publisher.get_subscription_count)

    def is_there() -> bool:
        publisher.publish(message)
        now = rig.seen["/follower/roi"][-1]
        return abs(now.x_offset - x) < 30 and abs(now.y_offset - y) < 30

    rig.wait(is_there)


def detection(x: float, y: float, width: float, height: float, name: str = "") -> Any:
    """Return a vision_msgs/Detection2D of a box in pixels."""
    from vision_msgs.msg import Detection2D, ObjectHypothesisWithPose

    message = Detection2D()
    message.bbox.center.position.x, message.bbox.center.position.y = x + width / 2, y + height / 2
    message.bbox.size_x, message.bbox.size_y = width, height
    result = ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = name, 0.9
    message.results = [result]
    return message


def test_a_region_chooses_another_target(watched) -> None:
    publisher = watched.node.create_publisher(RegionOfInterest, "/target_roi", 10)
    wanted = RegionOfInterest(x_offset=50, y_offset=400, width=60, height=50)
    chosen(watched, publisher, wanted, 50, 400)


def test_a_detection_chooses_another_target(watched) -> None:
    from vision_msgs.msg import Detection2D

    publisher = watched.node.create_publisher(Detection2D, "/target_detection", 10)
    chosen(watched, publisher, detection(500.0, 380.0, 60.0, 50.0), 500, 380)


def test_what_another_node_detects_reaches_the_tracker(watched) -> None:
    """By its class it is chosen; the tracker then asks for it under the name that it gave."""
    from vision_msgs.msg import Detection2DArray

    publisher = watched.node.create_publisher(Detection2DArray, "/others", 10)
    watched.wait(publisher.get_subscription_count)
    assert watched.set("follower", target="boat").successful, "asked for before one is seen"

    def tracked() -> bool:
        message = Detection2DArray(detections=[detection(120.0, 300.0, 60.0, 50.0, "boat")])
        message.header.stamp = watched.node.get_clock().now().to_msg()
        publisher.publish(message)
        now = watched.seen["/follower/roi"][-1]
        return abs(now.x_offset - 120) < 30 and abs(now.y_offset - 300) < 30

    watched.wait(tracked)


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


def test_what_another_node_detected_is_recorded_and_the_flight_replays_bit_for_bit(watched) -> None:
    flight = open_flight(watched.flights[-1])
    assert flight.config.run["detector"] == "ros:/others"
    names = {one.class_name for record in flight.detections for one in record.detections}
    assert names == {"boat"}
    result = replay(flight)
    assert result.strictness.is_exact
    assert result.comparison.identical, [one.name for one in result.comparison.differing]
