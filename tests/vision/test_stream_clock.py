"""A stream's own time stamps on our clock: even, in order, never later than the arrival."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.sources.stream_clock import StreamClock

RATE_HZ = 30.0


def stamped(stream_s: Sequence[float], arrival_s: Sequence[float]) -> np.ndarray:
    clock = StreamClock()
    return np.array([clock.captured_s(a, b) for a, b in zip(stream_s, arrival_s, strict=True)])


def test_jitter_of_the_way_is_not_in_the_stamps() -> None:
    rng = np.random.default_rng(5)
    taken = np.arange(3000) / RATE_HZ
    arrival = np.maximum.accumulate(taken + 0.02 + rng.exponential(0.03, taken.size))
    error, late = stamped(taken + 700, arrival)[60:] - taken[60:], (arrival - taken)[60:]
    assert late.std() > 0.02
    assert error.std() < late.std() / 10
    assert error.mean() == pytest.approx(0.02, abs=0.004)


def test_a_stall_of_the_network_makes_old_pictures_old() -> None:
    taken = np.arange(120) / RATE_HZ
    arrival = np.where((taken > 2) & (taken < 2.6), 2.6 + 1e-3 * (taken - 2), taken)
    assert stamped(taken, arrival) - taken == pytest.approx(np.zeros(120), abs=0.002)


@pytest.mark.parametrize("drift", [2e-4, -2e-4])
def test_a_clock_that_drifts_is_followed(drift: float) -> None:
    taken = np.arange(18_000) / RATE_HZ
    error = stamped(taken * (1 + drift), taken + 0.01) - taken
    assert abs(error[60:] - 0.01).max() < 0.002


@pytest.mark.parametrize("rate", [0.5, 0.9, 1.2])
def test_stamps_of_a_wrong_rate_never_make_pictures_much_older_than_their_arrival(
    rate: float,
) -> None:
    taken = np.arange(1800) / RATE_HZ
    age = taken - stamped(taken * rate, taken)
    assert age.max() <= 0.25 + 1.1 * abs(1 - rate)


def test_without_stamps_the_arrival_counts() -> None:
    clock = StreamClock()
    assert clock.captured_s(None, 5.0) == 5.0
    assert clock.captured_s(3.0, 5.1) == 5.1
    assert clock.captured_s(None, 5.3) == 5.3


def test_a_sender_that_begins_anew_is_taken_at_its_arrival() -> None:
    clock = StreamClock()
    for number in range(30):
        clock.captured_s(1000 + number / RATE_HZ, number / RATE_HZ)
    assert clock.captured_s(0.0, 1.4) == pytest.approx(1.4)


@given(
    st.lists(
        st.tuples(
            st.none() | st.floats(-1e6, 1e6),
            st.floats(0, 10).map(lambda s: round(s, 3)),
        ),
        max_size=60,
    )
)
def test_whatever_the_stamps_time_goes_on_and_not_beyond_the_arrival(
    steps: list[tuple[float | None, float]],
) -> None:
    clock, arrival_s, before_s = StreamClock(), 0.0, -1.0
    for number, (stream_s, step_s) in enumerate(steps):
        arrival_s += step_s
        captured_s = clock.captured_s(stream_s, arrival_s)
        assert before_s < captured_s <= arrival_s + 1e-6 * (number + 1)
        before_s = captured_s
