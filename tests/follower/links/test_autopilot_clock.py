"""The autopilot's clock on ours: delays, outliers, restarts, jumps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower.links.clock_sync import AutopilotClock, TimeSync, time_ns


@given(st.lists(st.floats(0.0, 0.3), min_size=20, max_size=60), st.floats(0, 1000))
def test_a_time_is_never_later_than_its_arrival_and_as_good_as_the_best_delay(
    delays: list[float], offset: float
) -> None:
    clock = AutopilotClock()
    for number, delay in enumerate(delays):
        boot_s = 0.5 * number
        mapped = clock.to_system(boot_s, offset + boot_s + delay)
        assert mapped <= offset + boot_s + delay + 1e-9
        assert mapped >= offset + boot_s - 1e-9
    assert mapped - offset - boot_s <= min(delays) + 1e-4 * (boot_s + 0.3) + 1e-9


@given(
    st.lists(st.tuples(st.floats(0.0, 0.2), st.floats(0.0, 0.2)), min_size=1, max_size=60),
    st.floats(-1000, 1000),
)
def test_the_error_is_never_larger_than_it_says_however_unequal_the_two_ways(
    ways: list[tuple[float, float]], offset: float
) -> None:
    clock = AutopilotClock()
    for number, (there, back) in enumerate(ways):
        boot_s = 1.0 + 0.5 * number
        clock.exchange(boot_s + offset - there, boot_s, boot_s + offset + back)
        mapped = clock.to_system(boot_s, boot_s + offset + back)
        assert clock.error_s is not None
        assert abs(mapped - boot_s - offset) <= clock.error_s + 1e-9
    quickest = min(there + back for there, back in ways)
    assert clock.error_s <= quickest / 2 + 1e-4 * 31 + 1e-3


def _settled(offset: float = 100.0) -> AutopilotClock:
    clock = AutopilotClock()
    for number in range(50):
        boot_s = 10.0 + 0.1 * number
        clock.exchange(boot_s + offset - 0.002, boot_s, boot_s + offset + 0.002)
    return clock


def test_a_single_stray_packet_changes_nothing() -> None:
    clock = _settled()
    assert clock.error_s == pytest.approx(0.003, abs=1e-4)  # half the round trip and half of 2 ms
    late = clock.to_system(3.0, 115.1)  # sent twelve seconds ago, and mapped to that time
    assert late == pytest.approx(103.0, abs=0.01)
    assert clock.to_system(500.0, 115.2) <= 115.2  # from the future
    clock.exchange(115.2, 900.0, 115.3)
    assert clock.to_system(15.2, 115.3) == pytest.approx(115.2, abs=0.01)
    assert clock.restarts == 0


@pytest.mark.parametrize("boot_s", [0.5, 5000.0])
def test_a_restart_and_a_jump_are_believed_after_five_in_a_row(boot_s: float) -> None:
    clock = _settled()
    for number in range(6):
        now_s = 130.0 + 0.02 * number
        mapped = clock.to_system(boot_s + 0.02 * number, now_s)
    assert clock.restarts == 1
    assert mapped == pytest.approx(now_s, abs=1e-3)


@pytest.mark.parametrize("before_s", [-5.0, 5.0], ids=["before we came", "while we listen"])
def test_an_autopilot_that_runs_for_seven_weeks_has_times_that_begin_anew(before_s: float) -> None:
    clock, wrap_s = AutopilotClock(), 2**32 / 1000
    for number in range(100):
        now_s = 100.0 + 0.1 * number
        boot_s = wrap_s - before_s + 0.1 * number  # as TIMESYNC tells it
        assert clock.to_system(boot_s % wrap_s, now_s) == pytest.approx(now_s, abs=0.01)
        clock.exchange(now_s - 0.002, boot_s, now_s + 0.002)
    assert clock.restarts == 0


def test_until_a_restart_is_believed_times_look_old_and_never_new() -> None:
    clock = _settled()
    assert clock.to_system(0.5, 130.0) == pytest.approx(100.5, abs=0.01)


@pytest.mark.parametrize("drift", [-5e-5, 5e-5])
def test_a_crystal_that_runs_wrong_is_followed(drift: float) -> None:
    clock = AutopilotClock()
    for number in range(3000):
        now_s = 0.2 * number
        boot_s = now_s * (1 + drift)
        clock.exchange(now_s - 0.001, boot_s, now_s + 0.003)
    assert clock.to_system(boot_s, now_s + 0.003) == pytest.approx(now_s, abs=0.004)
    assert clock.restarts == 0


@pytest.mark.parametrize("slow", [0.98, 0.99])
def test_a_simulation_that_loses_time_is_followed(slow: float) -> None:
    """PX4's SIH was recorded at 0.988 to 0.992 of real time, with messages at 50 Hz between."""
    clock = AutopilotClock()
    ages_s = [_heard(clock, step, slow * 0.02 * step) for step in range(5000)]
    assert max(ages_s[200:]) < 0.01
    assert clock.error_s is not None
    assert max(ages_s[200:]) < clock.error_s + 0.002
    assert clock.restarts == 0


@pytest.mark.parametrize("lost_s", [0.3, 0.9])
def test_time_that_a_simulation_loses_at_once_is_found_again_within_a_second(lost_s: float) -> None:
    clock = AutopilotClock()
    ages_s = [_heard(clock, step, 0.02 * step - lost_s * (step > 500)) for step in range(1000)]
    assert ages_s[502] == pytest.approx(lost_s, abs=0.02)
    assert max(ages_s[555:]) < 0.01


def _heard(clock: AutopilotClock, step: int, boot_s: float) -> float:
    """Hear a message 3 ms after it was sent, now and then an answer; return its age."""
    now_s = 0.02 * step + 0.003
    age_s = now_s - clock.to_system(round(boot_s, 3), now_s)
    if step % 10 == 0:
        clock.exchange(now_s - 0.008, boot_s, now_s)
    return age_s


def test_questions_go_at_their_rate_and_an_answer_counts_once() -> None:
    clock = AutopilotClock()
    sync = TimeSync(clock, rate_hz=5.0)
    stamps = [sync.question(0.02 * step) for step in range(51)]
    asked = [stamp for stamp in stamps if stamp is not None]
    assert len(asked) == 6
    assert sync.answer(7_000_000_000, asked[-1], 1.03)
    assert sync.round_trip_s == pytest.approx(0.03)
    before = clock.error_s
    assert not sync.answer(7_000_000_000, asked[-1], 1.0301)  # doubled on the way
    assert not sync.answer(9_000_000_000, 12345, 1.0302)  # nobody asked that
    assert clock.error_s == before
    assert sync.round_trip_s == pytest.approx(0.03)


def test_time_zero_is_no_question() -> None:
    assert time_ns(0.0) == 1


@pytest.mark.parametrize("answers", [True, False])
@pytest.mark.parametrize(("longest_s", "growth"), [(1.1, 5.0), (1.3, 0.3), (3.0, 0.3)])
def test_a_link_that_becomes_slow_makes_telemetry_old_and_never_new(
    longest_s: float, growth: float, answers: bool
) -> None:
    """Packets keep their order; answers are late by as much as messages."""
    clock, offset_s = AutopilotClock(), 500.0

    def delay_s(time_s: float) -> float:
        return 0.01 + min(max(growth * (time_s - 20.0), 0.0), longest_s)

    for step in range(3000):
        time_s = 0.02 * step
        arrival_s = time_s + delay_s(time_s)
        if answers and step % 10 == 0:
            clock.exchange(time_s - 0.005, time_s - offset_s, arrival_s)
        mapped_s = clock.to_system(time_s - offset_s, arrival_s)
        assert mapped_s <= time_s + 0.02 + 1e-4 * time_s
    assert clock.restarts == 0
