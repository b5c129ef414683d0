"""Consent, the switch, the sticks, the release's mode and commands, each by itself."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.pilot_and_operator import Consent, PilotOperatorInput, Sticks
from follower.flight.supervision.release import Release, release_mode
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.links.operator_commands import OperatorCommands
from follower.settings.supervisor import (
    ConsentSettings,
    ReleaseAction,
    ReleaseSettings,
    StickSettings,
)
from follower_control.servo.output_blend import NO_OFFSET
from follower_control.vehicle.state import Attitude, LocalPosition, RcChannels, VehicleState

OURS = VehicleState(mode="GUIDED", obeys_setpoints=True, armed=True)
THEIRS = replace(OURS, mode="LOITER", obeys_setpoints=False)


def with_sticks(*pulses: int, at_s: float = 0.0) -> VehicleState:
    return replace(OURS, rc=RcChannels(pulses, at_s))


class Switch:
    """A consent by the switch on channel 5, asked once every 0.1 s."""

    def __init__(self, **settings: object) -> None:
        wanted = {"kind": "rc", "rc_channel": 5} | settings
        self.consent = Consent(ConsentSettings(**wanted))  # type: ignore[arg-type]
        self.now_s = 0.0

    def set(self, pulse: int, state: SupervisorState = SupervisorState.READY) -> tuple[bool, bool]:
        self.now_s += 0.1
        vehicle = with_sticks(1500, 1500, 1000, 1500, pulse, at_s=self.now_s)
        self.consent.step(ConsentRequest.NONE, vehicle, state, self.now_s)
        return self.consent.given, self.consent.renewed


def test_a_switch_counts_from_when_it_was_seen_off() -> None:
    switch = Switch()
    assert switch.set(1900) == (False, False)
    assert switch.set(1100) == (False, False)
    assert switch.set(1900) == (True, True)
    assert switch.set(1900) == (True, False)


def test_a_switch_that_trembles_about_its_threshold_stays_on() -> None:
    switch = Switch()
    switch.set(1100)
    assert switch.set(1700)[0]
    assert switch.set(1660)[0]
    assert not switch.set(1640)[0]
    assert not switch.set(1690)[0]


def test_a_reversed_switch_is_on_below_its_threshold() -> None:
    switch = Switch(rc_reversed=True)
    assert switch.set(1900) == (False, False)
    assert switch.set(1100) == (True, True)


@pytest.mark.parametrize("pulse", [0, 65535, 700, 2300])
def test_what_can_be_no_pulse_is_off(pulse: int) -> None:
    switch = Switch()
    switch.set(1100)
    switch.set(1900)
    assert switch.set(pulse) == (False, False)
    assert switch.set(1900) == (False, False)


def test_letting_go_wants_the_switch_turned_again() -> None:
    switch = Switch()
    switch.set(1100)
    switch.set(1900)
    assert switch.set(1900, SupervisorState.RELEASED) == (False, False)
    assert switch.set(1100, SupervisorState.RELEASED) == (False, False)
    assert switch.set(1900, SupervisorState.RELEASED) == (True, True)


@pytest.mark.parametrize("kind", ["command", "terminal"])
def test_letting_go_takes_an_order_back(kind: str) -> None:
    consent = Consent(ConsentSettings(kind=kind))  # type: ignore[arg-type]
    consent.step(ConsentRequest.GIVE, OURS, SupervisorState.READY, 0.0)
    consent.step(ConsentRequest.NONE, OURS, SupervisorState.FOLLOWING, 0.1)
    assert consent.given
    consent.step(ConsentRequest.NONE, THEIRS, SupervisorState.RELEASED, 0.2)
    assert not consent.given
    consent.step(ConsentRequest.RENEW, THEIRS, SupervisorState.RELEASED, 0.3)
    assert (consent.given, consent.renewed) == (False, True)


def test_an_order_that_comes_with_the_takeover_does_not_survive_it() -> None:
    consent = Consent(ConsentSettings(kind="command"))
    consent.step(ConsentRequest.GIVE, THEIRS, SupervisorState.FOLLOWING, 0.1)
    consent.step(ConsentRequest.NONE, THEIRS, SupervisorState.RELEASED, 0.2)
    assert (consent.given, consent.renewed) == (False, False)


def test_consent_by_the_mode_alone_can_be_withdrawn_and_given_again() -> None:
    consent = Consent(ConsentSettings())
    assert consent.given
    consent.step(ConsentRequest.WITHDRAW, OURS, SupervisorState.FOLLOWING, 0.1)
    assert not consent.given
    consent.step(ConsentRequest.RENEW, OURS, SupervisorState.READY, 0.2)
    assert (consent.given, consent.renewed) == (False, False)
    consent.step(ConsentRequest.GIVE, OURS, SupervisorState.READY, 0.3)
    assert consent.given


@pytest.mark.parametrize("withdrawn", [False, True])
def test_the_pilots_modes_renew_consent_but_none_that_was_withdrawn(withdrawn: bool) -> None:
    consent = Consent(ConsentSettings(again="mode", own_mode_s=1.0))
    if withdrawn:
        consent.step(ConsentRequest.WITHDRAW, OURS, SupervisorState.READY, 0.0)
    renewed = False
    for step in range(60):
        consent.step(ConsentRequest.NONE, THEIRS, SupervisorState.RELEASED, 0.1 + 0.02 * step)
        renewed = renewed or consent.renewed
    assert renewed is not withdrawn
    assert consent.given is not withdrawn
    consent.step(ConsentRequest.GIVE, THEIRS, SupervisorState.RELEASED, 2.0)
    assert (consent.given, consent.renewed) == (True, True)


@pytest.mark.parametrize(
    ("vehicle", "counts"),
    [(THEIRS, True), (replace(THEIRS, failsafe=True), False), (OURS, False)],
)
def test_the_pilots_own_mode_has_to_stand_without_a_failsafe(
    vehicle: VehicleState, counts: bool
) -> None:
    consent = Consent(ConsentSettings(again="mode", own_mode_s=1.0))
    renewed = []
    for step in range(60):
        consent.step(ConsentRequest.NONE, vehicle, SupervisorState.RELEASED, 0.02 * step)
        renewed.append(consent.renewed)
    assert not any(renewed[:50])
    assert any(renewed) is counts


def steps(sticks: Sticks, *pulses: int, engaged: bool = True) -> Sticks:
    sticks.step(with_sticks(*pulses), engaged, 0.1)
    return sticks


def test_sticks_count_from_when_they_were_in_their_middle() -> None:
    sticks = Sticks(StickSettings(nudge=True))
    steps(sticks, 1500, 1100, 1500, 1500)
    assert (sticks.nudge, sticks.taken_over) == (NO_OFFSET, False)
    steps(sticks, 1500, 1500, 1500, 1500)
    steps(sticks, 1500, 1100, 1500, 1500)
    assert sticks.taken_over
    assert steps(sticks, 1500, 1100, 1500, 1500, engaged=False).taken_over
    assert steps(sticks, 1500, 1100, 1500, 1500).taken_over, "it is held still"
    assert steps(sticks, 1500, 1500, 1500, 1500, engaged=False).taken_over is False
    assert steps(sticks, 1500, 1100, 1500, 1500).taken_over is False


@pytest.mark.parametrize(("every_s", "gap"), [(0.1, (4.9, 5.5)), (0.53, (0, 0)), (1.0, (0, 0))])
def test_a_stick_takes_over_though_channels_are_rare_or_missed_for_a_moment(
    every_s: float, gap: tuple[float, float]
) -> None:
    sticks, heard_s, taken_s = Sticks(StickSettings()), -1.0, math.inf
    vehicle = OURS
    for step in range(400):
        now_s = 0.02 * step
        if now_s - heard_s >= every_s and not gap[0] <= now_s < gap[1]:
            heard_s = now_s
            vehicle = with_sticks(1900 if now_s >= 5.0 else 1500, 1500, 1500, 1500, at_s=now_s)
        sticks.step(vehicle, True, now_s)
        taken_s = min(taken_s, now_s) if sticks.taken_over else taken_s
    assert 5.0 <= taken_s <= max(5.0, gap[1]) + every_s + 0.02


def test_a_throttle_has_its_middle_where_it_stands() -> None:
    sticks = Sticks(StickSettings(nudge=True))
    steps(sticks, 1500, 1500, 1100, 1500)
    assert sticks.nudge == NO_OFFSET
    steps(sticks, 1500, 1500, 1300, 1500)
    assert sticks.nudge.elevation_rad < 0
    assert not steps(sticks, 1500, 1500, 1900, 1500).taken_over


def test_each_stick_shifts_one_thing_up_to_its_bound_and_no_farther() -> None:
    sticks = Sticks(StickSettings(nudge=True, takeover=None))
    steps(sticks, 1500, 1500, 1500, 1500)
    assert steps(sticks, 1500, 900, 1500, 1500).nudge.distance_m == -5.0
    assert steps(sticks, 1900, 1500, 1500, 1500).nudge.side_m_s == 1.5
    assert steps(sticks, 1500, 1500, 1500, 1900).nudge.azimuth_rad == -math.radians(15)
    assert steps(sticks, 1500, 1500, 1900, 1500).nudge.elevation_rad == -math.radians(15)
    assert steps(sticks, 1540, 1460, 1540, 1460).nudge == NO_OFFSET


pulses = st.integers(0, 65535) | st.integers(900, 2100)


@given(st.lists(pulses, max_size=18), st.booleans())
def test_no_pulses_whatever_shift_by_more_than_is_set(channels: list[int], engaged: bool) -> None:
    sticks = Sticks(StickSettings(nudge=True))
    steps(sticks, 1500, 1500, 1500, 1500)
    steps(sticks, *channels, engaged=engaged)
    nudge = sticks.nudge
    assert abs(nudge.distance_m) <= 5.0
    assert abs(nudge.side_m_s) <= 1.5
    assert max(abs(nudge.azimuth_rad), abs(nudge.elevation_rad)) <= math.radians(15)
    assert engaged or nudge == NO_OFFSET


@pytest.mark.parametrize("vehicle", [OURS, with_sticks(1900, 1500, 1500), with_sticks()])
def test_without_channels_nothing_happens(vehicle: VehicleState) -> None:
    sticks = Sticks(StickSettings(nudge=True))
    sticks.step(vehicle, True, 0.1)
    assert (sticks.nudge, sticks.taken_over) == (NO_OFFSET, False)


def test_channels_that_grew_old_count_no_more() -> None:
    sticks = Sticks(StickSettings(nudge=True))
    steps(sticks, 1500, 1500, 1500, 1500)
    steps(sticks, 1900, 1500, 1500, 1500)
    sticks.step(with_sticks(1900, 1500, 1500, 1500), True, 0.7)
    assert (sticks.nudge, sticks.taken_over) == (NO_OFFSET, True)


def flying_at(speed_m_s: float, now_s: float) -> VehicleState:
    attitude = Attitude(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, now_s)
    position = LocalPosition(0.0, 0.0, -10.0, speed_m_s, 0.0, 0.0, now_s)
    return replace(OURS, attitude=attitude, position=position)


def ask(
    release: Release,
    now_s: float,
    state: SupervisorState,
    speed_m_s: float = 0.0,
    reason: SupervisorReason = SupervisorReason.HOLD_TIMED_OUT,
    entries: int = 0,
) -> str | None:
    vehicle = replace(flying_at(speed_m_s, now_s), entries=entries)
    return release.step(now_s, state, reason, vehicle, "px4")


def test_the_vehicle_rests_before_a_mode_is_asked_for_and_not_for_ever() -> None:
    release = Release(ReleaseSettings(action=ReleaseAction.LAND))
    assert ask(release, 0.0, SupervisorState.HOLDING, 3.0) is None
    assert ask(release, 0.1, SupervisorState.RELEASED, 3.0) is None
    assert ask(release, 4.0, SupervisorState.RELEASED, 3.0) is None
    assert ask(release, 4.2, SupervisorState.RELEASED, 3.0) == "LAND"
    assert ask(release, 4.3, SupervisorState.RELEASED, 0.0) is None
    assert ask(release, 5.3, SupervisorState.RELEASED, 0.0) == "LAND"


def test_following_again_calls_the_release_off() -> None:
    release = Release(ReleaseSettings(action=ReleaseAction.RTL))
    ask(release, 0.0, SupervisorState.HOLDING)
    assert ask(release, 0.1, SupervisorState.RELEASED) == "RTL"
    assert ask(release, 0.2, SupervisorState.FOLLOWING) is None
    assert ask(release, 3.0, SupervisorState.READY) is None


def test_a_release_of_what_did_not_follow_changes_no_mode() -> None:
    release = Release(ReleaseSettings(action=ReleaseAction.RTL))
    ask(release, 0.0, SupervisorState.READY)
    assert ask(release, 0.1, SupervisorState.RELEASED) is None
    assert ask(release, 9.0, SupervisorState.RELEASED) is None


@pytest.mark.parametrize(
    "reason", [SupervisorReason.PILOT_TOOK_OVER, SupervisorReason.STICKS_MOVED]
)
def test_who_took_over_is_asked_for_no_mode(reason: SupervisorReason) -> None:
    release = Release(ReleaseSettings(action=ReleaseAction.LAND))
    ask(release, 0.0, SupervisorState.FOLLOWING)
    assert ask(release, 0.1, SupervisorState.RELEASED, reason=reason) is None
    assert ask(release, 9.0, SupervisorState.RELEASED, reason=reason) is None


def test_a_mode_taken_anew_between_two_steps_is_somebody_elses() -> None:
    release = Release(ReleaseSettings(action=ReleaseAction.LAND))
    ask(release, 0.0, SupervisorState.HOLDING)
    assert ask(release, 0.1, SupervisorState.RELEASED, 3.0) is None
    assert ask(release, 0.2, SupervisorState.RELEASED, 3.0, entries=1) is None
    assert ask(release, 9.0, SupervisorState.RELEASED, entries=1) is None


@pytest.mark.parametrize("action", [ReleaseAction.HOLD, ReleaseAction.HAND_BACK])
def test_holding_and_handing_back_need_no_mode(action: ReleaseAction) -> None:
    assert release_mode(action, "px4") is None
    assert release_mode(action, "ardupilot") is None


SEQUENCES = itertools.count(200)


def command(
    value: float, confirmation: int = 0, sequence: int | None = None
) -> mavlink.MAVLink_message:
    codec = mavlink.MAVLink(None, 255, 190)
    codec.seq = (next(SEQUENCES) if sequence is None else sequence) % 256
    packed = mavlink.MAVLink_command_long_message(
        1, 191, mavlink.MAV_CMD_USER_1, confirmation, value, *(0.0,) * 6
    ).pack(codec)
    return codec.decode(bytearray(packed))


@pytest.mark.parametrize(
    ("said", "new"),
    [
        (
            [(0.0, 1.0), (0.1, 1.0), (0.5, 0.0), (0.6, 1.0), (5.0, 1.0, 1), (7.0, 1.0), (30, 1, 2)],
            [True, False, True, True, False, True, True],
        ),
        ([(0.0, 1.0), (0.4, 0.0), (0.5, 1.0, 1)], [True, True, False]),
        ([(0.0, 0.0), (0.3, 0.0), (2.0, 0.0, 1)], [True, True, True]),
        ([(0.0, 1.0, 0, 7), (0.4, 0.0, 0, 8), (0.7, 1.0, 0, 7)], [True, True, False]),
        ([(0.0, 1.0, 0, 7), (8.0, 1.0, 0, 7)], [True, False]),
        ([(0.0, 0.0, 0, 8), (0.1, 1.0, 0, 7)], [True, False]),
        ([(0.0, 0.0, 0, 3), (0.1, 1.0, 0, 250)], [True, False]),
        ([(0.0, 0.0, 0, 250), (0.1, 1.0, 0, 3)], [True, True]),
        ([(0.0, 0.0, 0, 8), (5.0, 1.0, 0, 7)], [True, True]),
    ],
)
def test_a_command_that_was_doubled_repeated_or_delayed_is_none_but_a_withdrawal_always_is(
    said: list[tuple[float, float, int, int]], new: list[bool]
) -> None:
    """Each with its time, value, and perhaps confirmation and sequence number."""
    commands = OperatorCommands()
    for now_s, *sent in said:
        commands.receive(command(*sent), now_s)
    assert [one.is_new for one in commands.take()] == new
    assert commands.take() == []


def test_commands_that_nobody_takes_do_not_pile_up() -> None:
    commands = OperatorCommands()
    for number in range(1000):
        commands.receive(command(float(number)), 0.0)
    assert len(commands.take()) == 16


def test_a_withdrawal_is_heard_among_however_many() -> None:
    commands = OperatorCommands()
    for number in range(2, 100):
        commands.receive(command(float(number)), 0.0)
    commands.receive(command(0.0), 0.0)
    assert commands.take()[-1].value == 0.0


def humans() -> PilotOperatorInput:
    return PilotOperatorInput(ConsentSettings(kind="cockpit"), StickSettings())


def test_consent_counts_though_a_target_is_chosen_in_the_same_moment() -> None:
    people = humans()
    people.give(ConsentRequest.GIVE)
    people.choose()
    people.step(OURS, SupervisorState.READY, 0.0)
    assert people.consent.given


def test_a_choice_that_comes_late_does_not_undo_a_withdrawal() -> None:
    people = PilotOperatorInput(ConsentSettings(), StickSettings())
    people.give(ConsentRequest.WITHDRAW)
    people.step(OURS, SupervisorState.FOLLOWING, 0.0)
    people.choose()
    people.step(OURS, SupervisorState.RELEASED, 0.1)
    assert not people.consent.renewed
    people.give(ConsentRequest.GIVE)
    people.step(OURS, SupervisorState.RELEASED, 0.2)
    assert people.consent.renewed
    people.choose()
    people.step(OURS, SupervisorState.RELEASED, 0.3)
    assert people.consent.renewed


def test_the_switch_ends_a_stop_that_was_pressed_before_and_no_later_one() -> None:
    people = PilotOperatorInput(ConsentSettings(kind="rc", rc_channel=5), StickSettings())
    now_s = 0.0

    def step(pulse: int) -> bool:
        nonlocal now_s
        now_s += 0.1
        people.step(with_sticks(*(1500,) * 4, pulse, at_s=now_s), SupervisorState.RELEASED, now_s)
        return people.stop_requested

    people.press_stop()
    assert step(1900)
    assert step(1100)
    people.press_stop()
    assert step(1900), "pressed in the same moment"
    assert step(1100)
    assert not step(1900)
    assert people.consent.given
    people.press_stop()
    assert step(1900)


def test_a_stop_outdoes_a_consent_of_the_same_moment_in_whatever_order_they_come() -> None:
    for stop_first in (True, False):
        people = humans()
        if stop_first:
            people.press_stop()
        people.give(ConsentRequest.GIVE)
        if not stop_first:
            people.press_stop()
        people.step(OURS, SupervisorState.FOLLOWING, 0.0)
        assert people.stop_requested
        people.give(ConsentRequest.GIVE)
        people.step(OURS, SupervisorState.RELEASED, 0.1)
        assert not people.stop_requested


def test_a_withdrawal_that_comes_with_a_consent_leaves_a_stop_as_it_is() -> None:
    people = humans()
    people.press_stop()
    people.step(OURS, SupervisorState.FOLLOWING, 0.0)
    people.give(ConsentRequest.GIVE)
    people.give(ConsentRequest.WITHDRAW)
    people.step(OURS, SupervisorState.RELEASED, 0.1)
    assert people.stop_requested
