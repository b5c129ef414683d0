"""What the autopilot does by itself, where the link is cut or our program stalls or restarts."""

from typing import Any

import pytest
from people_flights import CONTROL_S, PILOTS, F, R, flavours
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.log import FlightLog
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower_control.vehicle.setpoint import HOLD


@pytest.mark.parametrize("gone_s", [0.3, 1.3, 2.0, 4.0])
def test_px4_that_comes_back_into_offboard_by_itself_is_not_followed_with(
    rig_of: Any, gone_s: float
) -> None:
    rig = rig_of("px4")
    rig.follow()
    rig.wire.cut = True
    rig.fly(gone_s)
    assert rig.autopilot.mode == ("OFFBOARD" if gone_s < 1 else "RTL")
    rig.wire.cut = False
    record = rig.fly(3.0)
    if gone_s < 1:
        assert record.state is F
    else:
        assert record.state is R
        assert record.reason in (SupervisorReason.LINK_LOST, SupervisorReason.NOT_HEARD)
        assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)


@pytest.mark.parametrize("phase_s", [0.0, 0.2, 0.4, 0.6, 0.8])
@pytest.mark.parametrize("most_bytes", [None, 1024], ids=["at once", "bit by bit"])
def test_after_a_stall_px4_is_not_called_out_of_a_failsafe_that_no_heartbeat_told_of(
    rig_of: Any, phase_s: float, most_bytes: int | None
) -> None:
    rig, setpoints_s = after_a_stall(rig_of, phase_s, 1.6, most_bytes)
    assert rig.autopilot.mode == "RTL"
    assert setpoints_s == []


@pytest.mark.parametrize("phase_s", [0.0, 0.5])
def test_after_a_stall_that_px4_bore_it_is_held_soon(rig_of: Any, phase_s: float) -> None:
    rig, setpoints_s = after_a_stall(rig_of, phase_s, 1.04)
    assert rig.autopilot.mode == "OFFBOARD"
    assert setpoints_s[0] < 0.1


@pytest.mark.parametrize("phase_s", [0.0, 0.5])
def test_a_stall_amid_a_step_sends_nothing_that_was_decided_before_it(
    rig_of: Any, phase_s: float
) -> None:
    rig = rig_of("px4")
    rig.follow()
    rig.fly(1.0 + phase_s)
    rig.stalls_within_a_step_s = 1.6
    rig.fly(CONTROL_S)
    stalled_s = rig.now_s - CONTROL_S
    assert rig.fly(2.0).state is R
    assert rig.autopilot.mode == "RTL"
    assert rig.wire.setpoints(stalled_s) == []


def after_a_stall(
    rig_of: Any, phase_s: float, length_s: float, most_bytes: int | None = None
) -> tuple[Any, list[float]]:
    """Return a rig two seconds after a stall, and how long after it setpoints left.

    Args:
        phase_s: from PX4's heartbeats to the stall's beginning.
        length_s: of the stall.
        most_bytes: that the line hands over at once.
    """
    rig = rig_of("px4")
    rig.wire.most_bytes = most_bytes
    rig.follow()
    rig.fly(1.0 + phase_s)
    rig.fly(length_s, stalled=True)
    stalled_s = rig.now_s
    assert rig.fly(2.0).state is R
    return rig, [at - stalled_s for at in rig.wire.setpoints(stalled_s)]


@flavours
def test_an_autopilot_that_talks_but_does_not_hear_us_is_let_go(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour)
    rig.follow()
    rig.fly(0.3)
    rig.autopilot.faults.deaf = True
    rig.fly(0.9)
    assert rig.log.controls[-1].state is F
    assert rig.until(R, 0.3).reason is SupervisorReason.NOT_HEARD
    # PX4 may have gone into its failsafe and come back between two of its own heartbeats.
    rig.autopilot.faults.deaf = False
    assert rig.fly(2.0).state is R


@flavours
def test_it_sinks_no_lower_above_home_than_it_may_where_positions_count_from_elsewhere(
    rig_of: Any, flavour: str
) -> None:
    """As on a second flight, from a higher place, without switching off in between."""
    rig = rig_of(flavour, "servo.elevation_deg=-5", "envelope.min_height_m=8")
    rig.autopilot.move_home(0.0, 0.0, -4.0)
    rig.follow()
    heights_m = [-rig.autopilot.state.position_m[2] - 4.0 for _ in range(60) if rig.fly(0.2)]
    assert 8.0 - 0.1 < min(heights_m) < 9.0


def test_answers_to_somebody_elses_questions_do_not_show_that_it_hears_us(rig_of: Any) -> None:
    """A router hands on to us what the autopilot answers to another computer."""
    rig = rig_of("px4")
    rig.follow()
    rig.autopilot.faults.deaf = True
    answer = mavlink.MAVLink_timesync_message(5_000, 12345).pack(mavlink.MAVLink(None, 1, 1))
    for _ in range(12):
        rig.theirs.send(answer)
        rig.fly(0.1)
    assert rig.log.controls[-1].reason is SupervisorReason.NOT_HEARD


def test_who_asks_seldom_does_not_take_silence_for_deafness(rig_of: Any) -> None:
    rig = rig_of("ardupilot", "link.mode_rate_hz=0", "link.timesync_rate_hz=0.2")
    rig.follow()
    assert rig.fly(4.0).state is F


def test_a_restart_of_ours_neither_ends_px4s_failsafe_nor_follows(rig_of: Any) -> None:
    rig = rig_of("px4")
    rig.follow()
    rig.fly(0.5)
    rig.wire.cut = True
    rig.fly(2.5)
    assert rig.autopilot.mode == "RTL"
    rig.begin(FlightLog())
    rig.wire.cut = False
    record = rig.fly(3.0)
    assert (record.state, record.reason) == (
        SupervisorState.TRACKING,
        SupervisorReason.AUTOPILOT_FAILSAFE,
    )
    assert rig.autopilot.mode == "RTL"
    # The pilot takes the vehicle, and with it ends the failsafe.
    rig.autopilot.switch_mode("POSCTL")
    rig.take_mode()
    rig.until(F)


@flavours
def test_by_setting_the_pilots_own_mode_counts_but_a_failsafe_does_not(
    rig_of: Any, flavour: str
) -> None:
    rig = rig_of(flavour, "consent.again=mode")
    rig.follow()
    left_s = rig.now_s
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.until(R)
    rig.fly(1.9)
    assert rig.wire.setpoints(left_s + 0.1) == []
    rig.until(SupervisorState.READY, 1.5)
    rig.take_mode()
    rig.until(F)


@pytest.mark.slow
def test_by_setting_a_failsafe_is_not_the_pilots_own_mode(rig_of: Any) -> None:
    rig = rig_of("px4", "consent.again=mode")
    rig.follow()
    rig.wire.cut = True
    rig.fly(2.0)
    # What we send is heard again only after PX4's next heartbeat has told of its failsafe.
    rig.wire.cut = False
    sends = rig.loop._link.send
    rig.loop._link.send = lambda _: None  # type: ignore[method-assign]
    rig.fly(2.0)
    rig.loop._link.send = sends  # type: ignore[method-assign]
    assert rig.autopilot.mode == "RTL"
    record = rig.fly(4.0)
    assert (record.state, record.sent, rig.autopilot.mode) == (R, False, "RTL")
