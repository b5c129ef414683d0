"""How soon a hidden target is found again, and whether another one is taken: closed cases."""

import numpy as np
import pytest

from follower_sim.kinematics import BodyState, TruthSample
from follower_sim.scoring.identity_score import (
    IdentityScore,
    TrackedFrame,
    WrongEnd,
    identity_score,
    wrong_end,
)


def truth(gone_s: float, back_s: float) -> list[TruthSample]:
    """Ten seconds at 50 Hz, in which the target is hidden for a while."""
    return [
        TruthSample(
            float(time_s),
            BodyState(float(time_s), (0.0, 0.0, -8.0)),
            (14.0, 0.0, 0.0),
            (0.0, 0.0, 0.0),
            1.0,
            0.0 if gone_s <= time_s < back_s else 1.0,
            16.0,
            0.0,
            -0.5,
        )
        for time_s in np.arange(0, 10, 0.02)
    ]


def frames(from_s: float, until_s: float, other: bool = False) -> list[TrackedFrame]:
    """Tracked frames at 25 Hz, on the target or on the other one."""
    overlaps = (0.0, 0.7) if other else (0.7, 0.0)
    return [TrackedFrame(float(time_s), *overlaps) for time_s in np.arange(from_s, until_s, 0.04)]


def test_the_time_to_find_it_again_counts_from_its_reappearance() -> None:
    tracked = frames(1, 4) + frames(7.6, 10)
    score = identity_score(truth(4, 7), tracked, others=True)
    assert score.disappearances == 1
    assert score.longest_hidden_s == pytest.approx(3.0, abs=0.05)
    assert score.slowest_found_s == pytest.approx(0.6, abs=0.05)
    assert score.never_found == 0
    assert score.mistaken_s == 0


def test_a_target_that_is_not_found_again_is_counted() -> None:
    score = identity_score(truth(4, 7), frames(1, 4), others=False)
    assert (score.disappearances, score.never_found) == (1, 1)
    assert score.slowest_found_s is None
    assert score.mistaken_s is None


def test_a_time_on_another_target_is_measured_as_its_longest_run() -> None:
    tracked = frames(1, 4) + frames(5, 6, other=True) + frames(7.2, 7.4, other=True)
    score = identity_score(truth(4, 7), tracked, others=True)
    assert score.mistaken_s == pytest.approx(0.96, abs=0.05)
    assert score.never_found == 1


def test_a_short_disappearance_and_one_before_the_first_track_do_not_count() -> None:
    assert identity_score(truth(4, 4.3), frames(1, 10), others=True).disappearances == 0
    assert identity_score(truth(0.5, 2.0), frames(3, 10), others=True).disappearances == 0


def test_a_target_that_was_never_tracked_has_no_figures() -> None:
    assert identity_score(truth(4, 7), [], others=False) == IdentityScore()


NEVER = (99.0, 99.0)
"""When a target is hidden that is in the open all the time."""


@pytest.mark.parametrize(
    ("hidden", "tracked", "ends"),
    [
        (NEVER, frames(1, 10), None),
        (NEVER, frames(1, 4) + frames(4, 10, other=True), WrongEnd.PLAIN_SWAP),
        ((4, 7), frames(1, 4) + frames(7.2, 10, other=True), WrongEnd.COVERED_SWAP),
        (NEVER, frames(1, 4), WrongEnd.LOST),
        ((8, 8.5), frames(1, 4), WrongEnd.LOST),
        ((4, 7), frames(1, 4), WrongEnd.NOT_FOUND),
        ((4, 7), frames(1, 4) + frames(5, 6, other=True) + frames(7.2, 10), None),
        ((4, 7), frames(1, 4) + frames(5, 5.2, other=True), WrongEnd.NOT_FOUND),
        ((8, 12), frames(1, 8), None),
        ((8, 12), frames(1, 8) + frames(8.5, 10, other=True), WrongEnd.COVERED_SWAP),
        ((8.6, 12), frames(1, 4), WrongEnd.LOST),
        ((6, 9.5), frames(1, 6), None),
        (NEVER, [], None),
    ],
)
def test_a_pursuit_that_ends_without_its_target_is_classed_by_where_it_went(
    hidden: tuple[float, float], tracked: list[TrackedFrame], ends: WrongEnd | None
) -> None:
    assert wrong_end(truth(*hidden), tracked, 10.0) is ends


def test_what_comes_after_the_end_of_a_pursuit_does_not_count() -> None:
    tracked = frames(1, 5)
    assert wrong_end(truth(*NEVER), tracked, 5.5) is None
    assert wrong_end(truth(*NEVER), tracked, 10.0) is WrongEnd.LOST


def test_two_of_the_classes_are_of_another_target() -> None:
    assert [one.value for one in WrongEnd if one.is_swap] == [
        "swap in plain sight",
        "swap under cover",
    ]
