"""The event queue that replaces threads and sleeping."""

import pytest

from follower.flight.lockstep import Lockstep
from follower_vision.clock import SimulatedClock


def test_events_run_in_the_order_of_their_times_and_then_of_their_adding() -> None:
    clock, seen = SimulatedClock(), list[tuple[str, float]]()
    lockstep = Lockstep(clock)
    for name, time_s in (("late", 2.0), ("first", 1.0), ("second", 1.0)):
        lockstep.at(time_s, lambda name=name: seen.append((name, clock.now())))  # type: ignore[misc]
    lockstep.run(lambda: False)
    assert seen == [("first", 1.0), ("second", 1.0), ("late", 2.0)]


def test_a_period_does_not_drift() -> None:
    clock, times = SimulatedClock(), list[float]()
    lockstep = Lockstep(clock)
    lockstep.every(0.1, lambda: times.append(clock.now()))
    lockstep.run(lambda: len(times) >= 1000)
    assert times[-1] == 999 * 0.1


def test_what_is_asked_for_in_the_past_happens_now() -> None:
    clock, times = SimulatedClock(5.0), list[float]()
    lockstep = Lockstep(clock)
    lockstep.at(1.0, lambda: times.append(clock.now()))
    lockstep.run(lambda: False)
    assert times == [5.0]


@pytest.mark.parametrize("period_s", [0.0, -1.0, float("nan")])
def test_a_period_that_never_ends_is_refused(period_s: float) -> None:
    with pytest.raises(ValueError, match="period"):
        Lockstep(SimulatedClock()).every(period_s, lambda: None)
