"""The supervisor's tables: every row from every state, and what comes first where two apply."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower.situation import Order, Situation
from follower.supervisor import ENGAGED, Reason, State, Supervisor, SupervisorSettings, next_state

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
NOT_YET, COAST, SEARCH = 0.79, 0.8, 10.0
Next = tuple[State, Reason]
F, C, S, H = State.FOLLOWING, State.COASTING, State.SEARCHING, State.HOLDING


@dataclass(frozen=True)
class Row:
    """One row of the tables: a situation, and what follows on each state."""

    name: str
    changes: dict[str, Any]
    before: Next
    engaged: Next | dict[State, Next] = field(default_factory=dict)

    def expected(self, state: State) -> Next:
        if state not in ENGAGED:
            return self.before
        return self.engaged[state] if isinstance(self.engaged, dict) else self.engaged


def let_go(reason: Reason) -> Next:
    return State.RELEASED, reason


def trouble(name: str, reason: Reason, **changes: float) -> Row:
    return Row(name, changes, (State.TRACKING, reason), (H, reason))


FOLLOW = (F, Reason.TARGET_SEEN)
UNSEEN_BEFORE = (State.TRACKING, Reason.TARGET_UNSEEN)
LOST = (S, Reason.TARGET_LOST)
STILL_HELD = (H, Reason.TARGET_UNSEEN)
ROWS = [
    Row("all is good", {}, FOLLOW, FOLLOW),
    Row(
        "stop",
        {"stop_requested": True},
        let_go(Reason.STOP_REQUESTED),
        let_go(Reason.STOP_REQUESTED),
    ),
    Row("our mode was left", {"mode_left": True}, let_go(Reason.PILOT_TOOK_OVER), FOLLOW),
    Row(
        "no target", {"target_chosen": False}, (State.IDLE, Reason.NO_TARGET), (H, Reason.NO_TARGET)
    ),
    trouble("no heartbeat", Reason.LINK_SILENT, heartbeat_age_s=3.01),
    trouble("stale telemetry", Reason.TELEMETRY_STALE, telemetry_age_s=0.51),
    trouble("no telemetry but heartbeats", Reason.TELEMETRY_STALE, telemetry_age_s=inf),
    trouble("no heartbeat ever", Reason.LINK_SILENT, heartbeat_age_s=inf),
    trouble("stale frames", Reason.FRAMES_STALE, frame_age_s=0.51),
    trouble("late control", Reason.CONTROL_LATE, control_gap_s=0.21),
    Row(
        "silence of all",
        {"heartbeat_age_s": 1.0, "telemetry_age_s": 1.0},
        (State.TRACKING, Reason.TELEMETRY_STALE),
        let_go(Reason.LINK_LOST),
    ),
    Row("not heard", {"answer_age_s": 1.0}, FOLLOW, let_go(Reason.NOT_HEARD)),
    Row(
        "control stood still",
        {"control_gap_s": 1.0},
        (State.TRACKING, Reason.CONTROL_LATE),
        let_go(Reason.CONTROL_STALLED),
    ),
    Row(
        "on the ground",
        {"flying": False},
        (State.TRACKING, Reason.NOT_FLYING),
        let_go(Reason.NOT_FLYING),
    ),
    Row(
        "a failsafe without another mode",
        {"failsafe": True},
        (State.TRACKING, Reason.AUTOPILOT_FAILSAFE),
        FOLLOW,
    ),
    Row(
        "a failsafe with another mode",
        {"failsafe": True, "mode_allows": False},
        (State.TRACKING, Reason.AUTOPILOT_FAILSAFE),
        let_go(Reason.AUTOPILOT_FAILSAFE),
    ),
    Row(
        "another mode",
        {"mode_allows": False},
        (State.READY, Reason.WAITING_FOR_PILOT),
        let_go(Reason.PILOT_TOOK_OVER),
    ),
    Row(
        "no consent",
        {"consent_given": False},
        (State.READY, Reason.WAITING_FOR_CONSENT),
        let_go(Reason.CONSENT_WITHDRAWN),
    ),
    Row(
        "sticks",
        {"sticks_moved": True},
        let_go(Reason.STICKS_MOVED),
        let_go(Reason.STICKS_MOVED),
    ),
    *(
        Row(f"{name} while it flew by our stream", changes, let_go(reason), let_go(reason))
        for name, reason, changes in (
            (
                "silence",
                Reason.LINK_LOST,
                {"stream_held": True, "heartbeat_age_s": 1.0, "telemetry_age_s": 1.0},
            ),
            ("no answer", Reason.NOT_HEARD, {"stream_held": True, "answer_age_s": 1.0}),
            ("no control", Reason.CONTROL_STALLED, {"stream_held": True, "control_gap_s": 1.0}),
        )
    ),
    trouble("poor navigation", Reason.NAVIGATION_POOR, navigation_poor=True),
    trouble("no page in control", Reason.COCKPIT_LOST, cockpit_lost=True),
    Row(
        "little battery",
        {"battery_low": True},
        (State.TRACKING, Reason.BATTERY_LOW),
        let_go(Reason.BATTERY_LOW),
    ),
    Row(
        "unseen for a moment",
        {"unseen_s": NOT_YET},
        UNSEEN_BEFORE,
        {F: (C, Reason.TARGET_UNSEEN), C: (C, Reason.TARGET_UNSEEN), S: LOST, H: STILL_HELD},
    ),
    Row(
        "unseen for longer",
        {"unseen_s": COAST},
        UNSEEN_BEFORE,
        {F: LOST, C: LOST, S: LOST, H: STILL_HELD},
    ),
    Row(
        "a bad estimate",
        {"estimate_good": False},
        UNSEEN_BEFORE,
        {F: LOST, C: LOST, S: LOST, H: STILL_HELD},
    ),
    Row(
        "unseen for as long as a search",
        {"unseen_s": SEARCH},
        UNSEEN_BEFORE,
        {F: LOST, C: LOST, S: LOST, H: (H, Reason.SEARCH_FAILED)},
    ),
    Row(
        "searched for long enough",
        {"unseen_s": SEARCH, "in_state_s": SEARCH},
        UNSEEN_BEFORE,
        {F: LOST, C: LOST, S: (H, Reason.SEARCH_FAILED), H: let_go(Reason.HOLD_TIMED_OUT)},
    ),
    Row(
        "held for long enough, unseen",
        {"unseen_s": 5.0, "in_state_s": 3.0},
        UNSEEN_BEFORE,
        {F: LOST, C: LOST, S: LOST, H: let_go(Reason.HOLD_TIMED_OUT)},
    ),
    Row("held for long enough, seen at last", {"in_state_s": 3.0}, FOLLOW, FOLLOW),
    Row(
        "held for long enough in trouble",
        {"frame_age_s": 9.0, "in_state_s": 3.0},
        (State.TRACKING, Reason.FRAMES_STALE),
        {
            F: (H, Reason.FRAMES_STALE),
            C: (H, Reason.FRAMES_STALE),
            S: (H, Reason.FRAMES_STALE),
            H: let_go(Reason.HOLD_TIMED_OUT),
        },
    ),
]
"""Consent renewed is no row: it makes RELEASED one of the states before following."""


def decide(state: State, **changes: object) -> Next:
    return next_state(state, replace(GOOD, **changes), SETTINGS)  # type: ignore[arg-type]


def in_words(row: Row) -> str:
    return row.name


@pytest.mark.parametrize("row", ROWS, ids=in_words)
@pytest.mark.parametrize("state", [state for state in State if state is not State.RELEASED])
def test_every_row_from_every_state(state: State, row: Row) -> None:
    assert decide(state, **row.changes) == row.expected(state)


@pytest.mark.parametrize("row", ROWS, ids=in_words)
def test_released_stays_released_whatever_is_so(row: Row) -> None:
    assert decide(State.RELEASED, **row.changes) == let_go(Reason.AWAITING_CONSENT)


@pytest.mark.parametrize("row", ROWS, ids=in_words)
def test_a_new_consent_begins_as_from_the_start(row: Row) -> None:
    assert decide(State.RELEASED, consent_renewed=True, **row.changes) == row.before


BEFORE_ORDER = [
    "stop",
    "our mode was left",
    "no target",
    "no heartbeat",
    "stale telemetry",
    "stale frames",
    "late control",
    "a bad estimate",
    "on the ground",
    "a failsafe without another mode",
    "another mode",
    "no consent",
]
ENGAGED_ORDER = [
    "stop",
    "a failsafe with another mode",
    "another mode",
    "sticks",
    "no consent",
    "on the ground",
    "silence of all",
    "not heard",
    "control stood still",
    "no heartbeat",
    "stale frames",
    "unseen for longer",
]
NAMED = {row.name: row for row in ROWS}


def orders(names: list[str]) -> list[tuple[str, str]]:
    return [(first, second) for i, first in enumerate(names) for second in names[i + 1 :]]


def both(first: str, second: str) -> dict[str, Any]:
    return NAMED[second].changes | NAMED[first].changes


@pytest.mark.parametrize("pair", orders(BEFORE_ORDER), ids=" before ".join)
@pytest.mark.parametrize("state", [State.IDLE, State.TRACKING, State.READY])
def test_the_higher_row_decides_before_following(state: State, pair: tuple[str, str]) -> None:
    assert decide(state, **both(*pair)) == NAMED[pair[0]].expected(state)


@pytest.mark.parametrize("pair", orders(ENGAGED_ORDER), ids=" before ".join)
@pytest.mark.parametrize("state", sorted(ENGAGED))
def test_the_higher_row_decides_while_following(state: State, pair: tuple[str, str]) -> None:
    assert decide(state, **both(*pair)) == NAMED[pair[0]].expected(state)


ages = st.floats(0, 20) | st.just(inf)
situations = st.builds(
    Situation,
    *[st.booleans(), ages, st.booleans(), ages, ages, ages, ages],
    *[st.booleans(), st.booleans(), st.booleans(), st.booleans(), ages],
    *[st.booleans(), st.booleans(), st.booleans(), st.booleans(), ages, st.sampled_from(Order)],
)


@given(st.sampled_from(State), situations)
def test_the_servo_steers_only_with_consent_link_frames_and_a_target(
    state: State, situation: Situation
) -> None:
    following, _ = next_state(state, situation, SETTINGS)
    if following.steers:
        assert situation.mode_allows
        assert situation.consent_given
        assert situation.flying
        assert not situation.stop_requested
        assert situation.heartbeat_age_s <= SETTINGS.link_timeout_s
        assert situation.telemetry_age_s <= SETTINGS.telemetry_timeout_s
        assert situation.frame_age_s <= SETTINGS.frame_timeout_s
        assert situation.control_gap_s <= SETTINGS.control_timeout_s
        assert situation.estimate_good
        assert situation.unseen_s < SETTINGS.coast_s


@given(st.sampled_from(State), situations)
def test_nothing_flies_by_us_without_mode_and_consent(state: State, situation: Situation) -> None:
    following, _ = next_state(state, situation, SETTINGS)
    if following.engaged:
        assert situation.mode_allows
        assert situation.consent_given
        assert state is not State.RELEASED or situation.consent_renewed


@given(st.sampled_from(sorted(ENGAGED)), situations)
def test_every_way_out_of_following_is_a_hold_or_a_release(
    state: State, situation: Situation
) -> None:
    assert next_state(state, situation, SETTINGS)[0] in ENGAGED | {State.RELEASED}


def climb_down(supervisor: Supervisor, see: Callable[[float], bool]) -> list[tuple[float, State]]:
    """Fly for 30 s with a target that is seen as `see` says; return the changes of state."""
    seen_s, changes = 0.0, []
    for step in range(1500):
        now_s = step * 0.02
        seen_s = now_s if see(now_s) else seen_s
        before = supervisor.state
        situation = replace(GOOD, unseen_s=now_s - seen_s, in_state_s=supervisor.in_state_s(now_s))
        if supervisor.step(situation, now_s) is not before:
            changes.append((now_s, supervisor.state))
    return changes


def test_the_ladder_takes_its_rungs_at_their_times() -> None:
    changes = climb_down(Supervisor(SETTINGS), lambda now_s: now_s < 1.0)
    assert [state for _, state in changes] == [F, C, S, H, State.RELEASED]
    seen_last_s = 0.98
    assert [time_s for time_s, _ in changes[1:]] == pytest.approx(
        [
            seen_last_s + 0.02,
            seen_last_s + SETTINGS.coast_s,
            seen_last_s + SETTINGS.coast_s + SETTINGS.search_s,
            seen_last_s + SETTINGS.coast_s + SETTINGS.search_s + SETTINGS.hold_s,
        ],
        abs=0.021,
    )


@pytest.mark.parametrize("back_s", [1.5, 8.0, 13.0])
def test_a_target_that_returns_on_any_rung_is_followed_again(back_s: float) -> None:
    changes = climb_down(Supervisor(SETTINGS), lambda now_s: not 1.0 <= now_s < back_s)
    assert changes[-1] == (pytest.approx(back_s, abs=0.021), F)


def test_a_target_that_returns_after_the_ladder_is_not() -> None:
    changes = climb_down(Supervisor(SETTINGS), lambda now_s: not 1.0 <= now_s < 15.0)
    assert changes[-1][1] is State.RELEASED


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
