"""Perception alone: tracks and the target's place go out, and nothing ever steers."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

from diagnostic_msgs.msg import DiagnosticArray
from faulty_simulator import in_the_air
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, RegionOfInterest
from std_srvs.srv import Trigger

from follower import open_flight, replay
from follower.apps.ros.conversion import attitude_of, stamp_s
from follower.apps.ros.detections import box_of
from follower.settings.settings import find_scenario
from follower.simulation.components import start_state
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.view import CameraView
from follower_sim.world.world import World
from follower_vision.geometry.box import Box

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
        from tf2_msgs.msg import TFMessage
        from vision_msgs.msg import Detection2D

        rig.watch(Detection2D, "/follower/detection")
        rig.watch(TFMessage, "/tf")
        rig.watch(Odometry, "/mavros/local_position/odom", qos_profile_sensor_data)
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


def test_the_transform_puts_the_target_where_its_place_is(watched) -> None:
    targets = watched.seen["/follower/target"]

    def both() -> list[tuple[Any, Any]]:
        moves = [one.transforms[0] for one in watched.seen["/tf"]]
        return [(m, t) for m in moves for t in targets if m.header.stamp == t.header.stamp]

    watched.wait(both)
    moved, target = both()[-1]
    assert (moved.header.frame_id, moved.child_frame_id) == ("map", "follower_target")
    place = moved.transform.translation
    assert (place.x, place.y) == pytest.approx((3.0, 20.0), abs=6.0)
    assert moved.transform.rotation.w == 1.0
    told = target.pose.pose.position
    assert (place.x, place.y, place.z) == (told.x, told.y, told.z)


def test_the_detection_is_the_tracks_box_around_the_car(watched) -> None:
    """Where the scene's lens puts the corners of the car's body, seen from the vehicle's pose."""
    message = watched.seen["/follower/detection"][-1]
    assert message.header.frame_id == "camera"
    (result,) = message.results
    assert result.hypothesis.class_id == "tracking"
    assert 0 < result.hypothesis.score <= 1
    taken_s, odometry = stamp_s(message.header.stamp), watched.seen["/mavros/local_position/odom"]
    pose = min(odometry, key=lambda one: abs(stamp_s(one.header.stamp) - taken_s)).pose.pose
    scenario = load_scenario(find_scenario("winding"))
    world, (north, east, _) = World(scenario), start_state(scenario).position_m
    place = pose.position.y + north, pose.position.x + east, -pose.position.z
    body = replace(
        in_the_air(scenario), position_m=place, attitude_rad=attitude_of(pose.orientation)
    )
    view = CameraView.of(body, scenario.camera.mount)
    pixels = scenario.camera.model.pixels(view.to_camera(world.target_corners(0, 0.0)))
    truth = Box.from_xywh(*pixels.min(axis=0), *np.ptp(pixels, axis=0))
    assert box_of(message).iou(truth) > 0.25, (box_of(message), truth)


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


def test_a_detection_that_is_not_finite_chooses_nothing_and_is_said(watched) -> None:
    from vision_msgs.msg import Detection2D

    publisher = watched.node.create_publisher(Detection2D, "/target_detection", 10)
    watched.wait(publisher.get_subscription_count)
    before = watched.seen["/follower/roi"][-1]

    def said() -> bool:
        publisher.publish(detection(math.nan, 380.0, 60.0, 50.0))
        return "a message of target_detection is left out" in watched.log("follower")

    watched.wait(said)
    now = watched.seen["/follower/roi"][-1]
    assert (now.x_offset, now.y_offset) == pytest.approx((before.x_offset, before.y_offset), abs=30)


def test_what_another_node_detects_reaches_the_tracker(watched) -> None:
    """By its class it is chosen; the tracker then asks for it under the name that it gave."""
    from vision_msgs.msg import Detection2DArray

    publisher = watched.node.create_publisher(Detection2DArray, "/others", 10)
    watched.wait(publisher.get_subscription_count)
    assert watched.set("follower", target="boat").successful, "asked for before one is seen"

    wrong = detection(400.0, 300.0, 60.0, 50.0, "boat")
    wrong.results[0].hypothesis.score = math.nan

    def tracked() -> bool:
        boat = detection(120.0, 300.0, 60.0, 50.0, "boat")
        message = Detection2DArray(detections=[wrong, boat])
        message.header.stamp = watched.node.get_clock().now().to_msg()
        publisher.publish(message)
        now = watched.seen["/follower/roi"][-1]
        return abs(now.x_offset - 120) < 30 and abs(now.y_offset - 300) < 30

    watched.wait(tracked)
    assert "a detection of /others is left out: it needs a score" in watched.log("follower")


@pytest.mark.parametrize(
    ("what", "how", "said"),
    [
        ("image", "missing", "tracking: frames stale"),
        ("image", "ahead", "set the clocks"),
        ("image", "back", "set the clocks"),
        *(
            ("pose", how, "telemetry stale")
            for how in ("missing", "attitude nan", "position nan", "ahead", "back")
        ),
    ],
)
def test_a_fault_is_said_no_place_is_told_by_it_and_whatever_the_mode_nothing_steers(
    watched, what: str, how: str, said: str
) -> None:
    watched.set("simulator", **{"mode": "OFFBOARD", what: how})
    watched.wait(lambda: said in watched.state)
    told = len(watched.seen["/follower/target"])
    watched.spin(2.0)
    assert what == "image" or len(watched.seen["/follower/target"]) == told
    assert not watched.seen["/follower/setpoint"]
    assert not watched.look().setpoints
    watched.set("simulator", **{what: ""})
    watched.wait(lambda: watched.state == "tracking: not flying")


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
    scores = {one.score for record in flight.detections for one in record.detections}
    assert scores == {0.9}
    result = replay(flight)
    assert result.strictness.is_exact
    assert result.comparison.identical, [one.name for one in result.comparison.differing]


def test_a_camera_info_that_is_not_finite_is_said_and_refuses(watched) -> None:
    watched.set("simulator", info="nan")
    assert watched.set("follower", mode="perception").successful
    assert watched.change("configure")
    assert not watched.change("activate")
    assert "camera_info is left out: not calibrated, not finite" in watched.log("follower")
    assert "lens: neither a field of view nor a focal length" in watched.log("follower")
    watched.wait(lambda: "cannot activate: preflight: " in watched.state)
