"""The second consent by command, switch and terminal, flown against both simulated autopilots."""

from typing import Any

import pytest
from people_flights import OURS, PILOTS, F, R, flavours
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower_control.vehicle.setpoint import HOLD

MIDDLE = (1500, 1500, 1500, 1500)


@flavours
def test_a_command_gives_consent_and_takes_it_back(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, "consent.kind=command")
    rig.take_mode()
    assert rig.fly(2.0).reason is SupervisorReason.WAITING_FOR_CONSENT
    assert rig.autopilot.mode == OURS[flavour]
    rig.command(1.0)
    rig.until(F, 0.1)
    assert rig.answers() == [mavlink.MAV_RESULT_ACCEPTED]
    rig.command(0.0)
    record = rig.until(R, 0.1)
    assert record.reason is SupervisorReason.CONSENT_WITHDRAWN
    record = rig.fly(3.0)
    assert (record.sent, rig.autopilot.mode) == (True, OURS[flavour])
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)
    rig.command(1.0)
    rig.until(F, 0.1)
    assert set(rig.answers()) == {mavlink.MAV_RESULT_ACCEPTED}


def test_a_command_from_anybody_else_or_for_another_consent_is_denied(rig_of: Any) -> None:
    rig = rig_of("ardupilot", "consent.kind=command")
    rig.hand_over()
    rig.command(1.0, system=42)
    rig.command(7.0)
    rig.command(float("nan"))
    assert rig.fly(2.0).reason is SupervisorReason.WAITING_FOR_CONSENT
    other = rig_of("ardupilot", "consent.kind=rc")
    other.hand_over()
    other.command(1.0)
    assert other.fly(1.0).reason is SupervisorReason.WAITING_FOR_CONSENT
    assert set(rig.answers() + other.answers()) == {mavlink.MAV_RESULT_DENIED}


def test_a_command_repeated_after_the_pilot_took_over_is_no_new_consent(rig_of: Any) -> None:
    rig = rig_of("ardupilot", "consent.kind=command")
    rig.hand_over()
    rig.command(1.0)
    rig.until(F)
    rig.autopilot.switch_mode("LOITER")
    rig.until(R)
    rig.command(1.0, confirmation=1)
    assert rig.fly(1.5).state is R
    assert rig.answers() == [mavlink.MAV_RESULT_ACCEPTED] * 2
    rig.command(1.0)
    rig.until(SupervisorState.READY)


@pytest.mark.slow
@flavours
def test_a_switch_gives_consent_when_it_is_turned_on(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, "consent.kind=rc", "consent.rc_channel=6")
    on, off = ((1500, 1500, 1500, 1500, 1000, pulse) for pulse in (1900, 1100))
    rig.autopilot.move_sticks(*on)
    rig.take_mode()
    # It is on from the start: nobody turned it.
    assert rig.fly(2.0).reason is SupervisorReason.WAITING_FOR_CONSENT
    rig.autopilot.move_sticks(*off)
    rig.fly(0.5)
    rig.autopilot.move_sticks(*on)
    rig.until(F, 0.3)
    off_s = rig.now_s
    rig.autopilot.move_sticks(*off)
    assert rig.until(R, 0.3).reason is SupervisorReason.CONSENT_WITHDRAWN
    assert rig.now_s - off_s < 0.2
    record = rig.fly(2.0)
    assert (record.sent, rig.autopilot.mode) == (True, OURS[flavour])
    rig.autopilot.move_sticks(*on)
    rig.until(F, 0.3)
    # The pilot takes over with the switch on: it has to be turned again.
    rig.autopilot.switch_mode(PILOTS[flavour])
    rig.until(R)
    assert rig.fly(2.0).state is R
    rig.autopilot.move_sticks(*off)
    rig.fly(0.3)
    rig.autopilot.move_sticks(*on)
    rig.until(SupervisorState.READY, 0.3)


@flavours
def test_after_a_stop_the_switch_gives_consent_anew(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, "consent.kind=rc", "consent.rc_channel=5")
    rig.autopilot.move_sticks(*MIDDLE, 1000)
    rig.hand_over()
    rig.fly(0.3)
    rig.autopilot.move_sticks(*MIDDLE, 2000)
    rig.until(F, 0.3)
    rig.stage.request_stop()
    rig.until(R, 0.1)
    rig.autopilot.move_sticks(*MIDDLE, 1000)
    assert rig.fly(0.5).state is R
    rig.autopilot.move_sticks(*MIDDLE, 2000)
    rig.until(F, 0.3)


def test_a_transmitter_that_falls_silent_withdraws_consent(rig_of: Any) -> None:
    rig = rig_of("ardupilot", "consent.kind=rc", "consent.rc_channel=5")
    rig.autopilot.move_sticks(1500, 1500, 1500, 1500, 1000)
    rig.hand_over()
    rig.fly(0.5)
    rig.autopilot.move_sticks(1500, 1500, 1500, 1500, 2000)
    rig.until(F, 0.3)
    rig.autopilot.move_sticks()
    assert rig.until(R, 1.3).reason is SupervisorReason.CONSENT_WITHDRAWN


@flavours
def test_the_terminal_gives_consent(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour, "consent.kind=terminal")
    rig.take_mode()
    assert rig.fly(2.0).state is SupervisorState.READY
    rig.stage.order(ConsentRequest.GIVE)
    rig.until(F, 0.1)
    rig.stage.order(ConsentRequest.WITHDRAW)
    assert rig.until(R, 0.1).reason is SupervisorReason.CONSENT_WITHDRAWN
