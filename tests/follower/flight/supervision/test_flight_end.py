"""Every way out of a flight has its sentence and its exit code, and the page has all of them."""

from typing import Any

import pytest
from flight_ends import ENDS, FLOWN
from hypothesis import given
from hypothesis import strategies as st

from follower.flight.supervision import flight_end as ends
from follower.flight.supervision.flight_end import RELEASES, FlightEnd, LastRelease
from follower.flight.supervision.inputs import SupervisorInputs
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState, next_state
from follower.settings.supervisor import SupervisorSettings

WAITING = (SupervisorState.READY, SupervisorReason.WAITING_FOR_PILOT)
FOLLOWING = (SupervisorState.FOLLOWING, SupervisorReason.TARGET_SEEN)
STOPPED = (SupervisorState.RELEASED, SupervisorReason.STOP_REQUESTED)
TAKEN_OVER = (SupervisorState.RELEASED, SupervisorReason.PILOT_TOOK_OVER)

ages = st.one_of(st.just(0.0), st.floats(0.0, 30.0))
situations = st.builds(
    SupervisorInputs,
    *(st.booleans(), ages, st.booleans(), ages, ages, ages, ages),
    *(st.booleans(), st.booleans(), st.booleans(), st.booleans(), ages),
    consent_given=st.booleans(),
    failsafe=st.booleans(),
    sticks_moved=st.booleans(),
    mode_left=st.booleans(),
    stream_held=st.booleans(),
    answer_age_s=ages,
    battery_low=st.booleans(),
)


def end_of(*steps: tuple[SupervisorState, SupervisorReason]) -> FlightEnd:
    return LastRelease.of(steps).end


@given(st.sampled_from(SupervisorState), situations)
def test_whatever_releases_the_vehicle_has_its_sentence(
    state: SupervisorState, situation: SupervisorInputs
) -> None:
    after, reason = next_state(state, situation, SupervisorSettings())
    if after is SupervisorState.RELEASED and state is not after:
        assert reason in {*RELEASES, SupervisorReason.STOP_REQUESTED}


@pytest.mark.parametrize("reason", RELEASES)
def test_what_released_it_is_said_and_a_stop_afterwards_changes_nothing(
    reason: SupervisorReason,
) -> None:
    released = SupervisorState.RELEASED, reason
    end = end_of(WAITING, FOLLOWING, released)
    assert end.exit_code in (ends.HANDED_OVER, ends.RELEASED_FOR_SAFETY)
    assert end == end_of(WAITING, FOLLOWING, released, WAITING, STOPPED)


def test_why_it_was_stopped_is_said_unless_something_else_released_it() -> None:
    release = LastRelease.of([WAITING, FOLLOWING])
    release.stopped_by = ends.NO_FRAMES
    assert release.end == ends.BROKEN_OFF
    release.take(*STOPPED)
    assert release.end == ends.NO_FRAMES
    release.take(*FOLLOWING)
    release.take(*TAKEN_OVER)
    assert release.end.exit_code == ends.HANDED_OVER


def test_the_pilots_takeover_is_a_handing_over_and_no_failure() -> None:
    end = end_of(FOLLOWING, TAKEN_OVER)
    assert end == FlightEnd("Handed over to the pilot, who took another mode", 3)


def test_a_hold_that_timed_out_names_its_cause() -> None:
    held = (SupervisorState.HOLDING, SupervisorReason.FRAMES_STALE)
    timed_out = (SupervisorState.RELEASED, SupervisorReason.HOLD_TIMED_OUT)
    assert end_of(FOLLOWING, held, timed_out).sentence == "Released after a hold: frames stale"


@pytest.mark.parametrize(
    ("steps", "end"),
    [
        ((), ends.NOT_BEGUN),
        ((WAITING, STOPPED), ends.NOT_BEGUN),
        ((FOLLOWING, STOPPED), ends.AS_ASKED),
        ((FOLLOWING, TAKEN_OVER, FOLLOWING, STOPPED), ends.AS_ASKED),
        ((FOLLOWING,), ends.BROKEN_OFF),
        ((FOLLOWING, TAKEN_OVER, FOLLOWING), ends.BROKEN_OFF),
    ],
)
def test_an_end_that_was_asked_for_or_never_came(steps: Any, end: FlightEnd) -> None:
    assert end_of(*steps) == end


def test_the_pages_table_is_that_of_the_program_and_has_every_end() -> None:
    assert ENDS.now() == ENDS.renewed(), "python tests/docs_tables/flight_ends.py"
    known = {end for end in vars(ends).values() if isinstance(end, FlightEnd)}
    assert known == set(FLOWN.values())
