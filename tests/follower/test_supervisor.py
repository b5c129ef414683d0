"""The supervisor's two tables, row by row."""

from dataclasses import replace
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower.supervisor import (
    ENGAGED,
    Reason,
    Situation,
    State,
    Supervisor,
    SupervisorSettings,
    next_state,
)

SETTINGS = SupervisorSettings()
GOOD = Situation(
    target_chosen=True,
    unseen_s=0.0,
    estimate_good=True,
    heartbeat_age_s=0.5,
    telemetry_age_s=0.02,
    frame_age_s=0.05,
    control_gap_s=0.02,
    mode_allows=True,
    flying=True,
    stop_requested=False,
    consent_renewed=False,
    in_state_s=0.0,
)
TROUBLES = [
    ({"heartbeat_age_s": 3.1}, Reason.LINK_SILENT),
    ({"heartbeat_age_s": inf}, Reason.LINK_SILENT),
    ({"telemetry_age_s": 0.51}, Reason.TELEMETRY_STALE),
    ({"frame_age_s": 0.51}, Reason.FRAMES_STALE),
    ({"control_gap_s": 0.21}, Reason.CONTROL_LATE),
]
WAYS_OUT = [
    ({"stop_requested": True}, Reason.STOP_REQUESTED),
    ({"mode_allows": False}, Reason.PILOT_TOOK_OVER),
    ({"flying": False}, Reason.NOT_FLYING),
]
BEFORE = [State.IDLE, State.TRACKING, State.READY]


def decide(state: State, **changes: object) -> tuple[State, Reason]:
    return next_state(state, replace(GOOD, **changes), SETTINGS)  # type: ignore[arg-type]


@pytest.mark.parametrize("state", BEFORE)
def test_nothing_is_followed_without_a_chosen_target(state: State) -> None:
    assert decide(state, target_chosen=False) == (State.IDLE, Reason.NO_TARGET)


@pytest.mark.parametrize("state", BEFORE)
def test_a_good_target_waits_for_the_pilots_mode(state: State) -> None:
    assert decide(state, mode_allows=False) == (State.READY, Reason.WAITING_FOR_PILOT)


@pytest.mark.parametrize("state", BEFORE)
def test_following_starts_when_all_is_good(state: State) -> None:
    assert decide(state) == (State.FOLLOWING, Reason.TARGET_SEEN)


@pytest.mark.parametrize("state", BEFORE)
@pytest.mark.parametrize(("changes", "reason"), TROUBLES)
def test_trouble_before_following_keeps_it_from_starting(
    state: State, changes: dict[str, object], reason: Reason
) -> None:
    assert decide(state, **changes) == (State.TRACKING, reason)


@pytest.mark.parametrize("state", BEFORE)
def test_an_unseen_target_or_a_vehicle_on_the_ground_is_not_followed(state: State) -> None:
    assert decide(state, unseen_s=0.1) == (State.TRACKING, Reason.TARGET_UNSEEN)
    assert decide(state, estimate_good=False) == (State.TRACKING, Reason.TARGET_UNSEEN)
    assert decide(state, flying=False) == (State.TRACKING, Reason.NOT_FLYING)


@pytest.mark.parametrize("state", sorted(ENGAGED))
@pytest.mark.parametrize(("changes", "reason"), WAYS_OUT)
def test_every_way_out_releases_at_once(
    state: State, changes: dict[str, object], reason: Reason
) -> None:
    assert decide(state, **changes) == (State.RELEASED, reason)


@pytest.mark.parametrize("state", sorted(ENGAGED))
@pytest.mark.parametrize(("changes", "reason"), TROUBLES)
def test_trouble_while_following_holds(
    state: State, changes: dict[str, object], reason: Reason
) -> None:
    assert decide(state, **changes) == (State.HOLDING, reason)


@pytest.mark.parametrize("state", sorted(ENGAGED))
def test_a_target_seen_again_is_followed(state: State) -> None:
    assert decide(state) == (State.FOLLOWING, Reason.TARGET_SEEN)


@pytest.mark.parametrize("state", [State.FOLLOWING, State.COASTING])
def test_an_unseen_target_is_coasted_then_searched(state: State) -> None:
    assert decide(state, unseen_s=0.4) == (State.COASTING, Reason.TARGET_UNSEEN)
    assert decide(state, unseen_s=0.8) == (State.SEARCHING, Reason.TARGET_LOST)
    assert decide(state, unseen_s=0.4, estimate_good=False) == (
        State.SEARCHING,
        Reason.TARGET_LOST,
    )


def test_a_search_never_coasts_and_ends_in_a_hold() -> None:
    assert decide(State.SEARCHING, unseen_s=0.4) == (State.SEARCHING, Reason.TARGET_LOST)
    assert decide(State.SEARCHING, unseen_s=15.0, in_state_s=10.0) == (
        State.HOLDING,
        Reason.SEARCH_FAILED,
    )


def test_a_hold_without_a_target_does_not_search_again() -> None:
    assert decide(State.HOLDING, unseen_s=12.0, in_state_s=1.0)[0] is State.HOLDING


@pytest.mark.parametrize("changes", [{"unseen_s": 12.0}, {"frame_age_s": 9.0}])
def test_a_hold_that_lasts_lets_go(changes: dict[str, object]) -> None:
    assert decide(State.HOLDING, in_state_s=3.0, **changes) == (
        State.RELEASED,
        Reason.HOLD_TIMED_OUT,
    )


def test_released_stays_released_whatever_becomes_good() -> None:
    assert decide(State.RELEASED)[0] is State.RELEASED


def test_released_begins_again_by_a_new_consent_alone() -> None:
    assert decide(State.RELEASED, consent_renewed=True, mode_allows=False)[0] is State.READY


ages = st.floats(0, 20) | st.just(inf)


@given(
    st.sampled_from(State),
    st.builds(
        Situation,
        *[st.booleans(), ages, st.booleans(), ages, ages, ages, ages],
        *[st.booleans(), st.booleans(), st.booleans(), st.booleans(), ages],
    ),
)
def test_the_servo_steers_only_with_consent_link_frames_and_a_target(
    state: State, situation: Situation
) -> None:
    following, _ = next_state(state, situation, SETTINGS)
    if following.steers:
        assert situation.mode_allows
        assert situation.flying
        assert not situation.stop_requested
        assert situation.heartbeat_age_s <= SETTINGS.link_timeout_s
        assert situation.telemetry_age_s <= SETTINGS.telemetry_timeout_s
        assert situation.frame_age_s <= SETTINGS.frame_timeout_s
        assert situation.control_gap_s <= SETTINGS.control_timeout_s
        assert situation.estimate_good
        assert situation.unseen_s < SETTINGS.coast_s


def test_the_shell_counts_the_time_in_a_state_and_keeps_the_reason_of_the_release() -> None:
    supervisor = Supervisor(SETTINGS)
    supervisor.step(GOOD, 10.0)
    supervisor.step(GOOD, 12.0)
    assert supervisor.in_state_s(12.5) == 2.5
    supervisor.step(replace(GOOD, mode_allows=False), 13.0)
    supervisor.step(replace(GOOD, mode_allows=False), 14.0)
    assert supervisor.state is State.RELEASED
    assert supervisor.reason is Reason.PILOT_TOOK_OVER
    assert supervisor.in_state_s(14.0) == 1.0


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), inf])
def test_a_timeout_that_is_no_time_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="search_s is a time in seconds above 0"):
        SupervisorSettings(search_s=value)
