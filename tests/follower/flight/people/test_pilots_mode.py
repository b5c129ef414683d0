"""The pilot's mode begins following and ends it, flown against both simulated autopilots."""

from typing import Any

import pytest
from people_flights import CONTROL_S, OURS, PILOTS, C, F, H, R, S, flavours
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.log import FlightLog
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower_control.vehicle.setpoint import HOLD


@pytest.mark.slow
@flavours
@pytest.mark.parametrize("state", [SupervisorState.READY, F, C, S, H])
def test_the_pilot_leaves_the_mode_and_setpoints_end_within_a_tenth_of_a_second(
    rig_of: Any, flavour: str, state: SupervisorState
) -> None:
    rig = (
        rig_of(flavour, "consent.kind=terminal")
        if state is SupervisorState.READY
        else rig_of(flavour)
    )
    if state is SupervisorState.READY:
        rig.take_mode()
        rig.fly(1.5)
        assert rig.log.controls[-1].reason is SupervisorReason.WAITING_FOR_CONSENT
    else:
        rig.reach(state)
    left_s = rig.now_s
    rig.autopilot.switch_mode(PILOTS[flavour])
    record = rig.fly(1.0)
    assert (record.state, record.reason) == (R, SupervisorReason.PILOT_TOOK_OVER)
    rig.seen = rig.frames_come = True
    assert rig.fly(5.0).state is R
    assert rig.wire.setpoints(left_s + 0.1) == []
    assert rig.autopilot.mode == PILOTS[flavour]


@flavours
def test_a_mode_that_stood_before_we_came_is_not_for_us(rig_of: Any, flavour: str) -> None:
    """A vehicle that flies in GUIDED does somebody's bidding; a program of ours may have died."""
    rig = rig_of(flavour)
    rig.follow()
    rig.begin(FlightLog())
    assert rig.fly(2.5).reason is SupervisorReason.WAITING_FOR_PILOT
    assert any("take it again" in text for text in rig.events("autopilot"))
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.fly(1.2)
    assert rig.autopilot.switch_mode(OURS[flavour])
    rig.until(F)


@flavours
def test_following_begins_anew_by_the_operator_and_the_pilot_alone(
    rig_of: Any, flavour: str
) -> None:
    rig = rig_of(flavour)
    rig.follow()
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.until(R)
    rig.fly(3.0)
    rig.stage.order(ConsentRequest.RENEW)
    assert rig.fly(3.0).state is SupervisorState.READY
    assert rig.autopilot.switch_mode(OURS[flavour])
    rig.until(F)


def test_guided_taken_again_is_somebody_elses(rig_of: Any) -> None:
    rig = rig_of("ardupilot")
    rig.follow()
    rig.autopilot.switch_mode("LOITER")
    rig.until(R)
    back_s = rig.now_s
    rig.autopilot.switch_mode("GUIDED")
    assert rig.fly(3.0).state is R
    assert rig.wire.setpoints(back_s) == []


def test_offboard_taken_again_at_once_gets_its_stream_and_stands_still(rig_of: Any) -> None:
    rig = rig_of("px4")
    rig.follow()
    rig.right_px = 60.0
    rig.fly(0.5)
    rig.autopilot.switch_mode("POSCTL")
    rig.until(R)
    assert rig.autopilot.switch_mode("OFFBOARD")
    record = rig.fly(3.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (R, True, "OFFBOARD")
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("phase_s", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.5, 0.9])
def test_offboard_entered_as_our_stream_ends_gets_it_back_and_stands_still(
    rig_of: Any, late_s: float, phase_s: float
) -> None:
    """PX4 lets a pilot enter for a second after the last setpoint, and flies home without more."""
    rig = rig_of("px4")
    rig.until(SupervisorState.READY)
    rig.fly(1.0 + phase_s)
    rig.seen = False
    rig.fly(late_s)
    assert rig.autopilot.switch_mode("OFFBOARD")
    record = rig.fly(4.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (
        SupervisorState.TRACKING,
        True,
        "OFFBOARD",
    )
    assert record.allowed == HOLD
    rig.autopilot.switch_mode("POSCTL")
    left_s = rig.now_s
    assert rig.fly(2.0).reason is SupervisorReason.PILOT_TOOK_OVER
    assert rig.wire.setpoints(left_s + 0.1) == []


@pytest.mark.slow
@flavours
@pytest.mark.parametrize("after_s", [0.1, 0.5, 3.0])
def test_consent_after_a_stop_follows_again_where_nobody_else_takes_the_mode(
    rig_of: Any, flavour: str, after_s: float
) -> None:
    rig = rig_of(flavour, "autonomy=full")
    rig.until(F, 8.0)
    rig.fly(1.0)
    rig.stage.request_stop()
    assert rig.fly(after_s).state is R
    rig.stage.order(ConsentRequest.GIVE)
    rig.until(F, 3.0)
    assert {rig.fly(CONTROL_S).state for _ in range(150)} == {F}


@flavours
def test_a_switch_there_and_back_between_two_steps_ends_the_following(
    rig_of: Any, flavour: str
) -> None:
    rig = rig_of(flavour, "release.action=land")
    rig.follow()
    # Both heartbeats come with the same poll.
    rig.autopilot.switch_mode(PILOTS[flavour])
    for _ in range(2):
        rig.theirs.send(_heartbeat(flavour, PILOTS[flavour]))
        rig.theirs.send(_heartbeat(flavour, OURS[flavour]))
    back_s = rig.now_s
    rig.autopilot.switch_mode(OURS[flavour])
    record = rig.fly(CONTROL_S)
    assert (record.state, record.reason) == (R, SupervisorReason.PILOT_TOOK_OVER)
    rig.fly(6.0)
    assert (rig.events("release"), rig.autopilot.mode) == ([], OURS[flavour])
    # PX4 would go into its failsafe without the stream; ArduCopter's GUIDED is somebody else's.
    assert (rig.wire.setpoints(back_s + 0.1) != []) is (flavour == "px4")


def _heartbeat(flavour: str, mode: str) -> bytes:
    modes = {"POSCTL": 3 << 16, "OFFBOARD": 6 << 16, "LOITER": 5, "GUIDED": 4}
    autopilots = {
        "px4": mavlink.MAV_AUTOPILOT_PX4,
        "ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    }
    message = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        autopilots[flavour],
        mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED,
        modes[mode],
        mavlink.MAV_STATE_ACTIVE,
        3,
    )
    return bytes(message.pack(mavlink.MAVLink(None, 1, 1)))
