"""What becomes of the vehicle after letting go, flown against both simulated autopilots."""

from typing import Any

import pytest
from people_flights import OURS, PILOTS, SHORT, C, H, R, S, flavours
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.supervision.supervisor import SupervisorReason
from follower_control.vehicle.setpoint import HOLD

RELEASES = [
    ("px4", "loiter", "LOITER"),
    ("px4", "rtl", "RTL"),
    ("px4", "land", "LAND"),
    ("ardupilot", "loiter", "BRAKE"),
    ("ardupilot", "rtl", "RTL"),
    ("ardupilot", "land", "LAND"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("flavour", "action", "mode"), RELEASES)
def test_the_ladder_ends_in_the_autopilots_own_mode(
    rig_of: Any, flavour: str, action: str, mode: str
) -> None:
    rig = rig_of(flavour, f"release.action={action}", *SHORT)
    rig.follow()
    rig.right_px = 80.0
    rig.fly(1.0)
    rig.seen = False
    for state in (C, S, H, R):
        rig.until(state)
    assert rig.log.controls[-1].reason is SupervisorReason.HOLD_TIMED_OUT
    rig.fly(5.0)
    assert rig.autopilot.mode == mode
    assert not rig.log.controls[-1].sent
    assert rig.events("release") == [f"asking for {mode}", f"the autopilot is in {mode}"]
    rungs = [text for text in rig.events("supervisor") if not text.startswith(("idle", "tracking"))]
    assert rungs[-5:] == [
        "following: target seen",
        "coasting: target unseen",
        "searching: target lost",
        "holding: search failed",
        "released: hold timed out",
    ]


@pytest.mark.slow
@flavours
def test_a_mode_that_is_refused_keeps_the_hold(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, "release.action=land", *SHORT)
    rig.autopilot.faults.refused_modes = ("LAND",)
    rig.follow()
    rig.stage.request_stop()
    record = rig.fly(8.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (R, True, OURS[flavour])
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)
    assert "LAND is not entered: holding, and asking again" in rig.events("release")
    rig.autopilot.faults.refused_modes = ()
    rig.fly(2.5)
    assert rig.autopilot.mode == "LAND"


@pytest.mark.slow
@flavours
def test_the_pilots_mode_is_not_taken_from_him(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, "release.action=rtl")
    rig.follow()
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.fly(6.0)
    assert rig.autopilot.mode == PILOTS[flavour]
    assert rig.events("release") == []


@flavours
def test_a_pilot_who_moved_the_sticks_is_not_landed(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, "release.action=land")
    rig.autopilot.move_sticks(1500, 1500, 1500, 1500)
    rig.follow()
    rig.autopilot.move_sticks(1500, 1150, 1500, 1500)
    assert rig.until(R).reason is SupervisorReason.STICKS_MOVED
    rig.fly(5.0)
    assert (rig.events("release"), rig.autopilot.mode) == ([], OURS[flavour])


@pytest.mark.slow
def test_handed_back_ardupilot_stays_where_it_is(rig_of: Any) -> None:
    rig = rig_of("ardupilot", "release.action=hand_back")
    rig.follow()
    rig.stage.request_stop()
    rig.fly(3.0)
    quiet_s = rig.now_s
    record = rig.fly(6.0)
    assert (record.sent, rig.autopilot.mode) == (False, "GUIDED")
    rig.loop.hold()  # the program ends
    assert rig.wire.setpoints(quiet_s) == []
    assert max(map(abs, rig.autopilot.state.velocity_m_s)) < 0.1


def test_a_program_that_ends_while_it_holds_says_so_once_more(rig_of: Any) -> None:
    rig = rig_of("ardupilot")
    rig.follow()
    rig.stage.request_stop()
    rig.fly(3.0)
    before = len(rig.wire.setpoints(0.0))
    rig.loop.hold()
    assert len(rig.wire.setpoints(0.0)) == before + 1


@flavours
def test_the_last_hold_of_a_loop_that_stood_still_calls_nobody_back(
    rig_of: Any, flavour: str
) -> None:
    """PX4 may fly home by now, and a setpoint would have it in OFFBOARD again."""
    rig = rig_of(flavour)
    rig.follow()
    rig.fly(1.5, stalled=True)
    quiet_s = rig.now_s - 0.1
    assert rig.loop.hold() is (flavour == "ardupilot")
    assert len(rig.wire.setpoints(quiet_s)) == (flavour == "ardupilot")


@pytest.mark.slow
def test_handed_back_px4_does_what_its_parameter_says(rig_of: Any) -> None:
    rig = rig_of("px4", "release.action=hand_back")
    rig.follow()
    rig.stage.request_stop()
    rig.fly(6.0)
    assert (rig.log.controls[-1].sent, rig.autopilot.mode) == (False, "RTL")


@pytest.mark.slow
@flavours
def test_nothing_changes_the_mode_unless_the_release_is_set_to(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, *SHORT)
    rig.follow()
    rig.seen = False
    rig.until(R)
    rig.fly(5.0)
    modes = [m for _, m in rig.wire.sent if m.get_type() == "COMMAND_LONG"]
    assert mavlink.MAV_CMD_DO_SET_MODE not in {m.command for m in modes}
    assert rig.autopilot.mode == OURS[flavour]
