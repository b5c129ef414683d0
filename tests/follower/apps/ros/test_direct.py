"""Mode direct: MAVLink to the autopilot, the picture by a topic; then in simulated time."""

import time
from collections.abc import Iterator

import pytest
from promises import LateS

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger

from follower import open_flight, replay
from follower.settings.settings import find_scenario
from follower_sim.scenario.scenario_file import load_scenario

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
SIMULATED_S = (100.0, 1000.0)
"""The test's /clock begins at the first and does not reach the second."""


@pytest.fixture(scope="module")
def flying(make_rig, free_port) -> Iterator:
    with make_rig() as rig:
        rig.begin("direct", free_port(), "--set", "recorder.video=lossless")
        yield rig


def test_the_recorded_flight_replays_bit_for_bit(flying) -> None:
    flying.follow()
    assert flying.change("deactivate"), flying.log("follower")
    result = replay(flying.flights[-1])
    assert result.strictness.is_exact
    assert result.comparison.identical
    assert any(one.sent for one in result.replay.log.controls)


def test_the_lens_is_camera_infos(flying) -> None:
    lens = load_scenario(find_scenario("winding")).camera.model
    camera = open_flight(flying.flights[-1]).config.settings["camera"]
    assert camera["focal_px"] == pytest.approx(lens.fx)
    assert camera["focal_width_px"] == lens.width
    assert camera["center_px"] == pytest.approx((lens.cx, lens.cy))


def test_a_clock_that_nobody_publishes_or_that_stands_refuses_in_one_line(flying) -> None:
    assert flying.change("cleanup")
    assert flying.set("follower", use_sim_time=True).successful
    assert flying.change("configure")
    for clock in ("", "standing"):
        flying.set("simulator", mode="LOITER", clock=clock)
        said = len(flying.log("follower"))
        assert not flying.change("activate")
        assert flying.log("follower")[said:].count("\n") == 1
        assert "/clock does not tick" in flying.log("follower")[said:]
        flying.wait(lambda: "/clock does not tick" in flying.state)


def test_in_simulated_time_it_follows_and_stamps_are_of_the_clock(flying) -> None:
    flying.set("simulator", clock="running")
    flying.set("follower", camera__focal_px=400.0)
    flying.watch(DiagnosticArray, "/follower/track")
    assert flying.change("activate"), flying.log("follower")
    flying.follow()
    first_s, last_s = SIMULATED_S
    for topic in ("/diagnostics", "/follower/track", "/follower/setpoint"):
        assert first_s < flying.seen[topic][-1].header.stamp.sec < last_s


@pytest.mark.parametrize("clock", ["standing", "back"])
def test_a_clock_that_stands_or_jumps_back_ends_the_following_and_nothing_moves(
    flying, late_s: LateS, clock: str
) -> None:
    flying.follow()
    from_s = time.monotonic()
    flying.set("simulator", clock=clock)
    flying.assert_keeps("frames-stop", from_s, late_s)
    assert not flying.state.startswith("following")
    flying.set("simulator", clock="running")


def test_after_a_jump_back_a_new_flight_follows_until_the_release_service_is_called(
    flying,
) -> None:
    assert flying.change("deactivate"), flying.log("follower")
    flying.set("simulator", mode="LOITER")
    assert flying.change("activate"), flying.log("follower")
    flying.follow()
    assert flying.call(Trigger, "/follower/release", Trigger.Request()).success
    flying.wait_for("released")
    flying.wait(lambda: flying.speed < 0.5)
    assert flying.change("deactivate"), flying.log("follower")


def test_flights_in_simulated_time_replay_bit_for_bit(flying) -> None:
    assert len(flying.flights) == 3
    for folder in flying.flights[1:]:
        result = replay(folder)
        assert result.strictness.is_exact
        assert result.comparison.identical


def test_the_settings_own_lens_goes_before_camera_infos(flying) -> None:
    camera = open_flight(flying.flights[-1]).config.settings["camera"]
    assert camera["focal_px"] == 400.0
    assert camera["center_px"] is None
