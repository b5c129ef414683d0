"""The supervisor's promises through MAVROS' topics, between two processes."""

import math
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

from geometry_msgs.msg import TwistStamped
from rcl_interfaces.srv import DescribeParameters, GetParameters
from rclpy.qos import ReliabilityPolicy
from std_srvs.srv import Trigger

from follower import open_flight, replay

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def flying(make_rig) -> Iterator:
    with make_rig() as rig:
        rig.simulator()
        rig.follower("--mode", "mavros")
        rig.activate()
        yield rig


def test_nothing_moves_before_the_pilot_consents_and_then_it_follows(flying) -> None:
    flying.spin(2.0)
    assert not flying.state.startswith("following")
    flying.follow()
    assert flying.seen["/truth"][-1].header.frame_id == "OFFBOARD"
    taken = flying.seen["/taken"][-1].twist.linear
    assert math.hypot(taken.x, taken.y, taken.z) > 0
    assert flying.seen["/follower/setpoint"]


@pytest.mark.parametrize(
    ("what", "fault"),
    [
        ("image", "missing"),
        ("image", "ahead"),
        ("image", "back"),
        ("pose", "missing"),
        ("pose", "nan"),
        ("pose", "ahead"),
        ("pose", "back"),
    ],
)
def test_what_is_missing_not_finite_or_of_another_time_ends_the_following(
    flying, what: str, fault: str
) -> None:
    flying.assert_ends_following(what, fault)


def reliabilities(ends: list[Any]) -> list[ReliabilityPolicy]:
    return [one.qos_profile.reliability for one in ends]


def test_sensors_are_best_effort_results_reliable_and_setpoints_as_mavros_takes_them(
    flying,
) -> None:
    """MAVROS subscribes to setpoint_raw as to sensors: best effort."""
    best, reliable = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
    node = flying.node
    taken = {"/image": best, "/mavros/imu/data": best, "/mavros/state": reliable}
    for topic, wanted in taken.items():
        assert reliabilities(node.get_subscriptions_info_by_topic(topic)) == [wanted]
    given = {"/mavros/setpoint_raw/local": best, "/follower/setpoint": reliable}
    given |= {"/follower/track": reliable, "/follower/target": reliable}
    for topic, wanted in given.items():
        assert reliabilities(node.get_publishers_info_by_topic(topic)) == [wanted]


def test_settings_change_in_flight_as_far_as_they_may(flying) -> None:
    assert flying.set("follower", servo__mode="watch").successful
    refused = flying.set("follower", envelope__max_speed_m_s=50.0)
    assert not refused.successful
    assert "tightened" in refused.reason
    assert not flying.set("follower", tracker="re3").successful
    assert flying.set("follower", servo__mode="chase").successful
    request = DescribeParameters.Request(names=["servo.distance_m"])
    told = flying.call(DescribeParameters, "/follower/describe_parameters", request)
    assert told.descriptors[0].description


def test_services_change_the_follow_mode_in_flight(flying) -> None:
    for mode in ("orbit", "chase"):
        answer = flying.call(Trigger, f"/follower/follow_mode/{mode}", Trigger.Request())
        assert answer.success, answer.message
        request = GetParameters.Request(names=["servo.mode"])
        told = flying.call(GetParameters, "/follower/get_parameters", request)
        assert told.values[0].string_value == mode
        flying.spin(0.5)
    refused = flying.set("follower", servo__mode="dance")
    assert not refused.successful
    assert "'chase', 'watch', 'side', 'orbit' or 'overhead'" in refused.reason


def test_an_unusable_target_is_refused_in_words(flying) -> None:
    refused = flying.set("follower", target="#nocolour")
    assert not refused.successful
    assert refused.reason


def test_deactivated_under_way_it_answers_when_the_vehicle_is_released_and_stands(flying) -> None:
    flying.follow()
    assert flying.change("deactivate"), flying.log("follower")
    flying.wait(lambda: flying.stands)
    last = flying.seen["/taken"][-1].twist.linear
    assert (last.x, last.y, last.z) == pytest.approx((0, 0, 0), abs=1e-3)
    ended = len(flying.seen["/taken"])
    flying.spin(1.5)
    assert len(flying.seen["/taken"]) == ended
    assert flying.state == "inactive"


def test_a_flight_through_mavros_replays_bit_for_bit(flying) -> None:
    """Its setpoints, from the tracks; the video is lossy."""
    result = replay(flying.flights[-1], vision=False)
    assert result.strictness.is_exact
    assert result.comparison.identical
    assert any(one.sent for one in result.replay.log.controls)
    controls = open_flight(flying.flights[-1]).log.controls
    modes = [c.value for one in controls for c in one.changes if c.key == "servo.mode"]
    assert modes[-2:] == ['"orbit"', '"chase"']


def test_killed_it_sends_nothing_more_and_the_autopilot_stands_by_itself(flying) -> None:
    flying.set("simulator", mode="LOITER")
    assert flying.change("activate"), flying.log("follower")
    flying.follow()
    killed = flying.processes["follower"]
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    flying.spin(1.0)
    ended = len(flying.seen["/taken"])
    flying.wait(lambda: flying.stands)
    assert flying.seen["/truth"][-1].header.frame_id != "OFFBOARD"
    assert len(flying.seen["/taken"]) == ended


def test_a_polite_kill_brakes_and_releases_first(make_rig) -> None:
    with make_rig() as rig:
        rig.simulator("ardupilot")
        rig.watch(TwistStamped, "/taken", 50)
        rig.watch(TwistStamped, "/truth")
        rig.set("simulator", mode="LOITER")
        rig.spin(3.0)
        # MAVROS hands on nothing of ArduPilot's estimator.
        rig.follower("--mode", "mavros", "--activate", "--skip-preflight", "estimator")
        rig.wait_for("ready")
        rig.spin(1.0)
        rig.set("simulator", mode="GUIDED")
        rig.wait_for("following")
        rig.processes["follower"].send_signal(signal.SIGTERM)
        began = time.monotonic()
        rig.wait(lambda: rig.processes["follower"].poll() is not None)
        assert rig.processes["follower"].returncode == 0, rig.log("follower")
        assert time.monotonic() - began < 30
        rig.wait(lambda: rig.stands)
        last = rig.seen["/taken"][-1].twist.linear
        assert (last.x, last.y, last.z) == pytest.approx((0, 0, 0), abs=1e-3)
