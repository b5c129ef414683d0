"""States held against the truth, in cases whose answer can be counted by hand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.evaluation.metrics import (
    mean_state_accuracy,
    median_s,
    share_soon,
    state_accuracy,
)
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import TrackState

HERE, AWAY = Box(50, 50, 20, 20), Box(200, 50, 20, 20)
TRUTH = {"t": HERE, ".": None}
BOX = {"h": HERE, "a": AWAY, ".": None}
STATE = {"T": TrackState.TRACKING, "C": TrackState.COASTING, "L": TrackState.LOST}


def held(truth: str, boxes: str, states: str):
    """One letter a frame; ten frames a second."""
    return state_accuracy(
        [BOX[b] for b in boxes], [STATE[s] for s in states], [TRUTH[t] for t in truth], 0.1
    )


def test_an_honest_tracker_has_nothing_to_hide() -> None:
    said = held("tttt..tt", "hhhhaahh", "TTTTLLTT")
    assert (said.false_tracking, said.absent_tracking, said.doubted) == (0, 0, 0)
    assert said.returns_s == (0.0,)
    assert said.losses_s == ()


def test_the_first_frame_is_not_scored() -> None:
    assert held("tt", "ah", "TT").false_tracking == 0


def test_tracking_beside_the_target_is_a_lie_and_coasting_there_is_none() -> None:
    said = held("ttttt", "haaah", "TTTCT")
    assert said.false_tracking == pytest.approx(2 / 4)
    assert said.doubted == 0


def test_tracking_without_a_target_is_counted_apart() -> None:
    said = held("tt...", "hhaaa", "TTTTL")
    assert (said.false_tracking, said.absent_tracking) == (0, pytest.approx(2 / 3))


def test_a_right_box_that_is_not_believed_is_doubted() -> None:
    said = held("ttttt", "hhhhh", "TTCLT")
    assert said.doubted == pytest.approx(2 / 4)


def test_without_a_right_box_nothing_can_be_doubted() -> None:
    assert held("ttt", "haa", "TTL").doubted is None


def test_a_return_counts_until_a_right_box_is_called_tracking() -> None:
    said = held("tt..tttt", "hhaaahhh", "TTLLLCTT")
    assert said.returns_s == (pytest.approx(0.2),)


def test_a_return_that_is_never_seen_is_infinite() -> None:
    assert held("tt..tt.t", "hhaaaaaa", "TTLLLLLL").returns_s == (math.inf, math.inf)


def test_a_loss_lasts_from_the_first_wrong_frame_to_the_first_right_one() -> None:
    said = held("tttttttt", "hhaaahhh", "TTTLLLTT")
    assert said.losses_s == (pytest.approx(0.4),)


def test_a_short_doubt_is_no_loss() -> None:
    assert held("ttttt", "hhhhh", "TTCTT").losses_s == ()


def test_a_loss_that_ends_with_the_sequence_is_infinite_and_with_the_leaving_none() -> None:
    assert held("tttt", "hhaa", "TTLL").losses_s == (math.inf,)
    assert held("tttt..tt", "hhaaaahh", "TTLLLLTT").losses_s == ()


def test_two_losses_in_one_stay_are_two() -> None:
    said = held("tttttttt", "hahhaahh", "TTTTLLTT")
    assert said.losses_s == (pytest.approx(0.1), pytest.approx(0.2))


def test_medians_and_shares() -> None:
    assert median_s(()) is None
    assert share_soon(()) is None
    assert median_s((0.1, 0.3, math.inf)) == 0.3
    assert median_s((0.1, math.inf)) == math.inf
    assert share_soon((0.1, 0.5, math.inf)) == pytest.approx(1 / 3)


def test_the_mean_weighs_sequences_alike_and_gathers_times() -> None:
    one, other = held("ttttt", "haaah", "TTTTT"), held("tt.t", "hh.h", "TTLT")
    mean = mean_state_accuracy([one, other])
    assert mean.false_tracking == pytest.approx((3 / 4 + 0) / 2)
    assert mean.absent_tracking == 0
    assert (len(mean.returns_s), len(mean.losses_s)) == (1, 1)


@pytest.mark.slow
@given(st.lists(st.tuples(*map(st.sampled_from, ("t.", "ha.", "TCL"))), min_size=1, max_size=30))
def test_whatever_is_said_the_shares_are_shares(rows) -> None:
    truth, boxes, states = ("".join(letters) for letters in zip(*rows, strict=True))
    said = held(f"t{truth}", f"h{boxes}", f"T{states}")
    shares = (said.false_tracking, said.absent_tracking, said.doubted)
    assert all(share is None or 0 <= share <= 1 for share in shares)
    assert all(time_s >= 0 for time_s in (*said.returns_s, *said.losses_s))
    assert len(said.returns_s) == f"t{truth}".count(".t")
