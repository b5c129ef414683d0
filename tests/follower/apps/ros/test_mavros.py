"""Mode mavros: topics of MAVROS, settings and services in flight."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rcl_interfaces.srv import DescribeParameters, GetParameters
from rclpy.qos import ReliabilityPolicy
from std_srvs.srv import Trigger

from follower import open_flight, replay
from follower.apps.ros.vehicle_topics import MavrosTopics

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def flying(make_rig, free_port) -> Iterator:
    with make_rig() as rig:
        rig.begin("mavros", free_port())
        yield rig


@pytest.mark.parametrize("how", ["ahead", "back"])
def test_a_pose_whose_stamps_jump_counts_as_missing(flying, late_s, how: str) -> None:
    flying.assert_holds("pose", how, "telemetry-stops", late_s)


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
    assert "there are chase, watch, side, orbit, overhead" in refused.reason


def test_an_unusable_target_is_refused_in_words(flying) -> None:
    refused = flying.set("follower", target="#nocolour")
    assert not refused.successful
    assert refused.reason


def test_a_flight_through_mavros_replays_bit_for_bit(flying) -> None:
    """Its setpoints, from the tracks; the video is lossy."""
    assert flying.change("deactivate"), flying.log("follower")
    result = replay(flying.flights[-1], vision=False)
    assert result.strictness.is_exact
    assert result.comparison.identical
    assert any(one.sent for one in result.replay.log.controls)
    controls = open_flight(flying.flights[-1]).log.controls
    modes = [c.value for one in controls for c in one.changes if c.key == "servo.mode"]
    assert modes[-2:] == ['"orbit"', '"chase"']


def test_an_answer_may_come_while_a_command_is_sent() -> None:
    """It comes on the node's thread, the command is sent on control's."""

    class Asked(str):
        def __eq__(self, other: object) -> bool:
            waiting.pop(("info",), None)
            return False

        __hash__ = str.__hash__

    waiting = {(Asked("parameter"), "one"): None, ("info",): None}
    topics = MagicMock(_waiting=waiting)
    numbers = {f"param{n}": 0.0 for n in range(1, 8)}
    message = SimpleNamespace(command=mavlink.MAV_CMD_REQUEST_MESSAGE, confirmation=0, **numbers)
    MavrosTopics._send_command(topics, message)
    topics._call.assert_called_once()
