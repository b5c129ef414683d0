"""The supervisor's promises through ROS: MAVROS' topics, or MAVLink and the picture by a topic."""

import signal
import time
from collections.abc import Iterator

import pytest
from promises import LateS

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]


@pytest.fixture(scope="module", params=["mavros", "direct"])
def flying(request, make_rig, free_port) -> Iterator:
    with make_rig() as rig:
        # Consent is renewed, and zeros are sent, only when a takeover has been looked at.
        rig.begin(request.param, free_port(), "--set", "consent.own_mode_s=10")
        yield rig


def test_nothing_moves_before_the_pilot_consents_and_then_it_follows(flying) -> None:
    flying.wait_for("ready")
    flying.spin(1.0)
    sent = flying.look().setpoints
    assert sent
    assert all(one.is_zero for one in sent)
    flying.follow()
    assert flying.mode == "OFFBOARD"
    assert flying.seen["/follower/setpoint"]


@pytest.mark.parametrize(
    ("what", "how", "fault"),
    [
        ("image", "missing", "frames-stop"),
        ("image", "ahead", "frames-stop"),
        ("image", "back", "frames-stop"),
        ("pose", "missing", "telemetry-stops"),
        ("pose", "attitude nan", "attitude-nan"),
        ("pose", "position nan", "position-nan"),
    ],
)
def test_what_is_missing_not_finite_or_of_another_time_is_held_for(
    flying, late_s: LateS, what: str, how: str, fault: str
) -> None:
    flying.assert_holds(what, how, fault, late_s)


def test_a_pilot_who_takes_another_mode_has_the_vehicle(flying, late_s: LateS) -> None:
    flying.follow()
    from_s = time.monotonic()
    flying.set("simulator", mode="LOITER")
    flying.wait_for("released: pilot took over")
    flying.assert_keeps("pilot-while-following", from_s, late_s)
    assert flying.mode == "LOITER"


def test_deactivated_under_way_it_answers_when_the_vehicle_is_released_and_stands(
    flying, late_s: LateS
) -> None:
    flying.follow()
    from_s = time.monotonic()
    assert flying.change("deactivate"), flying.log("follower")
    flying.assert_releases("stop-requested", from_s, late_s)
    flying.wait_for("inactive")


def test_killed_it_sends_nothing_more_and_the_autopilot_stands_by_itself(
    flying, late_s: LateS
) -> None:
    flying.activate()
    flying.follow()
    from_s = time.monotonic()
    flying.processes["follower"].kill()
    flying.assert_keeps("process-killed", from_s, late_s)


@pytest.mark.parametrize("mode", ["mavros", "direct"])
def test_a_polite_kill_brakes_and_releases_first(
    make_rig, free_port, late_s: LateS, mode: str
) -> None:
    with make_rig() as rig:
        # MAVROS hands on nothing of ArduPilot's estimator.
        rig.begin(mode, free_port(), "--skip-preflight", "estimator", flavour="ardupilot")
        rig.follow()
        from_s = time.monotonic()
        rig.processes["follower"].send_signal(signal.SIGTERM)
        rig.wait(lambda: rig.processes["follower"].poll() is not None)
        assert rig.processes["follower"].returncode == 0, rig.log("follower")
        rig.assert_releases("process-terminated", from_s, late_s)
