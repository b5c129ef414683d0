"""The supervisor's tables: every row from every state, and what comes first where two apply."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower.flight.supervision.inputs import ConsentRequest, SupervisorInputs
from follower.flight.supervision.supervisor import (
    ENGAGED,
    Supervisor,
    SupervisorReason,
    SupervisorState,
    next_state,
)
from follower.settings.supervisor import SupervisorSettings

SETTINGS = SupervisorSettings()
GOOD = SupervisorInputs(
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
Next = tuple[SupervisorState, SupervisorReason]
F, C, S, H = (
    SupervisorState.FOLLOWING,
    SupervisorState.COASTING,
    SupervisorState.SEARCHING,
    SupervisorState.HOLDING,
)


@dataclass(frozen=True)
class Row:
    """One row of the tables: a situation, and what follows on each state."""

    name: str
    changes: dict[str, Any]
    before: Next
    engaged: Next | dict[SupervisorState, Next] = field(default_factory=dict)

    def expected(self, state: SupervisorState) -> Next:
        if state not in ENGAGED:
            return self.before
        return self.engaged[state] if isinstance(self.engaged, dict) else self.engaged


def let_go(reason: SupervisorReason) -> Next:
    return SupervisorState.RELEASED, reason


def trouble(name: str, reason: SupervisorReason, **changes: float) -> Row:
    return Row(name, changes, (SupervisorState.TRACKING, reason), (H, reason))


FOLLOW = (F, SupervisorReason.TARGET_SEEN)
UNSEEN_BEFORE = (SupervisorState.TRACKING, SupervisorReason.TARGET_UNSEEN)
LOST = (S, SupervisorReason.TARGET_LOST)
STILL_HELD = (H, SupervisorReason.TARGET_UNSEEN)
ROWS = [
    Row("all is good", {}, FOLLOW, FOLLOW),
    Row(
        "stop",
        {"stop_requested": True},
        let_go(SupervisorReason.STOP_REQUESTED),
        let_go(SupervisorReason.STOP_REQUESTED),
    ),
    Row("our mode was left", {"mode_left": True}, let_go(SupervisorReason.PILOT_TOOK_OVER), FOLLOW),
    Row(
        "no target",
        {"target_chosen": False},
        (SupervisorState.IDLE, SupervisorReason.NO_TARGET),
        (H, SupervisorReason.NO_TARGET),
    ),
    trouble("no heartbeat", SupervisorReason.LINK_SILENT, heartbeat_age_s=3.01),
    trouble("stale telemetry", SupervisorReason.TELEMETRY_STALE, telemetry_age_s=0.51),
    trouble("no telemetry but heartbeats", SupervisorReason.TELEMETRY_STALE, telemetry_age_s=inf),
    trouble("no heartbeat ever", SupervisorReason.LINK_SILENT, heartbeat_age_s=inf),
    trouble("stale frames", SupervisorReason.FRAMES_STALE, frame_age_s=0.51),
    trouble("late control", SupervisorReason.CONTROL_LATE, control_gap_s=0.21),
    Row(
        "silence of all",
        {"heartbeat_age_s": 1.0, "telemetry_age_s": 1.0},
        (SupervisorState.TRACKING, SupervisorReason.TELEMETRY_STALE),
        let_go(SupervisorReason.LINK_LOST),
    ),
    Row("not heard", {"answer_age_s": 1.0}, FOLLOW, let_go(SupervisorReason.NOT_HEARD)),
    Row(
        "control stood still",
        {"control_gap_s": 1.0},
        (SupervisorState.TRACKING, SupervisorReason.CONTROL_LATE),
        let_go(SupervisorReason.CONTROL_STALLED),
    ),
    Row(
        "on the ground",
        {"flying": False},
        (SupervisorState.TRACKING, SupervisorReason.NOT_FLYING),
        let_go(SupervisorReason.NOT_FLYING),
    ),
    Row(
        "a failsafe without another mode",
        {"failsafe": True},
        (SupervisorState.TRACKING, SupervisorReason.AUTOPILOT_FAILSAFE),
        FOLLOW,
    ),
    Row(
        "a failsafe with another mode",
        {"failsafe": True, "mode_allows": False},
        (SupervisorState.TRACKING, SupervisorReason.AUTOPILOT_FAILSAFE),
        let_go(SupervisorReason.AUTOPILOT_FAILSAFE),
    ),
    Row(
        "another mode",
        {"mode_allows": False},
        (SupervisorState.READY, SupervisorReason.WAITING_FOR_PILOT),
        let_go(SupervisorReason.PILOT_TOOK_OVER),
    ),
    Row(
        "no consent",
        {"consent_given": False},
        (SupervisorState.READY, SupervisorReason.WAITING_FOR_CONSENT),
        let_go(SupervisorReason.CONSENT_WITHDRAWN),
    ),
    Row(
        "sticks",
        {"sticks_moved": True},
        let_go(SupervisorReason.STICKS_MOVED),
        let_go(SupervisorReason.STICKS_MOVED),
    ),
    *(
        Row(f"{name} while it flew by our stream", changes, let_go(reason), let_go(reason))
        for name, reason, changes in (
            (
                "silence",
                SupervisorReason.LINK_LOST,
                {"stream_held": True, "heartbeat_age_s": 1.0, "telemetry_age_s": 1.0},
            ),
            ("no answer", SupervisorReason.NOT_HEARD, {"stream_held": True, "answer_age_s": 1.0}),
            (
                "no control",
                SupervisorReason.CONTROL_STALLED,
                {"stream_held": True, "control_gap_s": 1.0},
            ),
        )
    ),
    trouble("poor navigation", SupervisorReason.NAVIGATION_POOR, navigation_poor=True),
    trouble("no page in control", SupervisorReason.COCKPIT_LOST, cockpit_lost=True),
    Row(
        "little battery",
        {"battery_low": True},
        (SupervisorState.TRACKING, SupervisorReason.BATTERY_LOW),
        let_go(SupervisorReason.BATTERY_LOW),
    ),
    Row(
        "unseen for a moment",
        {"unseen_s": NOT_YET},
        UNSEEN_BEFORE,
        {
            F: (C, SupervisorReason.TARGET_UNSEEN),
            C: (C, SupervisorReason.TARGET_UNSEEN),
            S: LOST,
            H: STILL_HELD,
        },
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
        {F: LOST, C: LOST, S: LOST, H: (H, SupervisorReason.SEARCH_FAILED)},
    ),
    Row(
        "searched for long enough",
        {"unseen_s": SEARCH, "in_state_s": SEARCH},
        UNSEEN_BEFORE,
        {
            F: LOST,
            C: LOST,
            S: (H, SupervisorReason.SEARCH_FAILED),
            H: let_go(SupervisorReason.HOLD_TIMED_OUT),
        },
    ),
    Row(
        "held for long enough, unseen",
        {"unseen_s": 5.0, "in_state_s": 3.0},
        UNSEEN_BEFORE,
        {F: LOST, C: LOST, S: LOST, H: let_go(SupervisorReason.HOLD_TIMED_OUT)},
    ),
    Row("held for long enough, seen at last", {"in_state_s": 3.0}, FOLLOW, FOLLOW),
    Row(
        "held for long enough in trouble",
        {"frame_age_s": 9.0, "in_state_s": 3.0},
        (SupervisorState.TRACKING, SupervisorReason.FRAMES_STALE),
        {
            F: (H, SupervisorReason.FRAMES_STALE),
            C: (H, SupervisorReason.FRAMES_STALE),
            S: (H, SupervisorReason.FRAMES_STALE),
            H: let_go(SupervisorReason.HOLD_TIMED_OUT),
        },
    ),
]
"""Consent renewed is no row: it makes RELEASED one of the states before following."""


def decide(state: SupervisorState, **changes: object) -> Next:
    return next_state(state, replace(GOOD, **changes), SETTINGS)  # type: ignore[arg-type]


def in_words(row: Row) -> str:
    return row.name


@pytest.mark.parametrize("row", ROWS, ids=in_words)
@pytest.mark.parametrize(
    "state", [state for state in SupervisorState if state is not SupervisorState.RELEASED]
)
def test_every_row_from_every_state(state: SupervisorState, row: Row) -> None:
    assert decide(state, **row.changes) == row.expected(state)


@pytest.mark.parametrize("row", ROWS, ids=in_words)
def test_released_stays_released_whatever_is_so(row: Row) -> None:
    assert decide(SupervisorState.RELEASED, **row.changes) == let_go(
        SupervisorReason.AWAITING_CONSENT
    )


@pytest.mark.parametrize("row", ROWS, ids=in_words)
def test_a_new_consent_begins_as_from_the_start(row: Row) -> None:
    assert decide(SupervisorState.RELEASED, consent_renewed=True, **row.changes) == row.before


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


BEFORE = (SupervisorState.IDLE, SupervisorState.TRACKING, SupervisorState.READY)


@pytest.mark.parametrize(
    ("state", "first", "second"),
    [
        (state, *pair)
        for states, order in ((BEFORE, BEFORE_ORDER), (sorted(ENGAGED), ENGAGED_ORDER))
        for state in states
        for pair in orders(order)
    ],
)
def test_the_higher_row_decides(state: SupervisorState, first: str, second: str) -> None:
    assert decide(state, **both(first, second)) == NAMED[first].expected(state)


ages = st.floats(0, 20) | st.just(inf)
situations = st.builds(
    SupervisorInputs,
    *[st.booleans(), ages, st.booleans(), ages, ages, ages, ages],
    *[st.booleans(), st.booleans(), st.booleans(), st.booleans(), ages],
    *[
        st.booleans(),
        st.booleans(),
        st.booleans(),
        st.booleans(),
        ages,
        st.sampled_from(ConsentRequest),
    ],
)


@given(st.sampled_from(SupervisorState), situations)
def test_the_servo_steers_only_with_consent_link_frames_and_a_target(
    state: SupervisorState, situation: SupervisorInputs
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


@given(st.sampled_from(SupervisorState), situations)
def test_nothing_flies_by_us_without_mode_and_consent(
    state: SupervisorState, situation: SupervisorInputs
) -> None:
    following, _ = next_state(state, situation, SETTINGS)
    if following.engaged:
        assert situation.mode_allows
        assert situation.consent_given
        assert state is not SupervisorState.RELEASED or situation.consent_renewed


@given(st.sampled_from(sorted(ENGAGED)), situations)
def test_every_way_out_of_following_is_a_hold_or_a_release(
    state: SupervisorState, situation: SupervisorInputs
) -> None:
    assert next_state(state, situation, SETTINGS)[0] in ENGAGED | {SupervisorState.RELEASED}


def climb_down(
    supervisor: Supervisor, see: Callable[[float], bool]
) -> list[tuple[float, SupervisorState]]:
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
    assert [state for _, state in changes] == [F, C, S, H, SupervisorState.RELEASED]
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
    assert changes[-1][1] is SupervisorState.RELEASED


def test_the_shell_counts_the_time_in_a_state_and_keeps_the_reason_of_the_release() -> None:
    supervisor = Supervisor(SETTINGS)
    supervisor.step(GOOD, 10.0)
    supervisor.step(GOOD, 12.0)
    assert supervisor.in_state_s(12.5) == 2.5
    supervisor.step(replace(GOOD, mode_allows=False), 13.0)
    supervisor.step(replace(GOOD, mode_allows=False), 14.0)
    assert supervisor.state is SupervisorState.RELEASED
    assert supervisor.reason is SupervisorReason.PILOT_TOOK_OVER
    assert supervisor.in_state_s(14.0) == 1.0
