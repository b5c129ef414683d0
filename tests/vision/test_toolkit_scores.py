"""The toolkits' figures in closed form; `test_toolkits.py` has the toolkits themselves say them."""

import pytest

from follower_vision.evaluation.toolkits import mean_toolkit_score, toolkit_score
from follower_vision.geometry.box import Box

SIZE = (100, 80)
TRUE = Box.from_xywh(20, 30, 40, 20)


def shifted(right: float) -> Box:
    return TRUE.moved_to(TRUE.cx + right, TRUE.cy)


def test_otb_counts_the_first_frame_and_got10k_does_not() -> None:
    score = toolkit_score([None, shifted(10), shifted(80)], [TRUE] * 3, SIZE)
    # Overlaps 1, 0.6 and 0 lie above 20, 12 and 0 of the 21 thresholds.
    assert score.otb_success == pytest.approx(32 / 63)
    assert (score.otb_rate, score.otb_precision) == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    assert (score.got10k_ao, score.got10k_sr) == (pytest.approx(0.3), 0.5)


def test_got10k_moves_a_corner_inside_and_cuts_what_then_stands_out() -> None:
    answered = Box.from_xywh(-10, 30, 40, 20)  # becomes 0,30,40,20
    past = Box.from_xywh(80, 30, 40, 20)  # becomes 80,30,20,20
    score = toolkit_score([TRUE, answered, TRUE], [TRUE, TRUE, past], SIZE)
    assert score.got10k_ao == pytest.approx((20 / 60 + 0) / 2)
    at_the_edge = toolkit_score([TRUE, past], [TRUE, past.moved_to(105, 40)], SIZE)
    assert at_the_edge.got10k_ao == pytest.approx(15 / 20)


def test_vot_counts_whole_pixels_after_ten_frames() -> None:
    wrong, near = shifted(80), Box.from_xywh(20.4, 30.4, 40.4, 20.4)  # rounds to the truth
    score = toolkit_score([wrong] * 10 + [near, shifted(10)], [TRUE] * 12, SIZE)
    assert score.vot_accuracy == pytest.approx((1 + 0.6) / 2)


def test_vot_counts_only_pixels_of_the_image() -> None:
    true, answered = Box.from_xywh(90, 10, 20, 10), Box.from_xywh(95, 10, 20, 10)
    score = toolkit_score([true] * 10 + [answered], [true] * 11, SIZE)
    assert score.vot_accuracy == pytest.approx(5 / 10)
    beside = Box.from_xywh(120, 10, 20, 10)
    assert toolkit_score([true] * 11, [true] * 10 + [beside], SIZE).vot_accuracy == 0


def test_a_missing_box_is_a_miss_and_an_absent_target_is_not_scored() -> None:
    score = toolkit_score([TRUE, None, TRUE], [TRUE, TRUE, None], SIZE)
    assert (score.got10k_ao, score.otb_rate, score.otb_precision) == (0, 0.5, 0.5)
    assert (score.overlaps, score.frames) == (1, 3)
    with pytest.raises(ValueError, match="no frame"):
        toolkit_score([TRUE, TRUE], [TRUE, None], SIZE)


def test_vot_has_no_figure_where_the_regions_are_no_boxes() -> None:
    whole, around = (toolkit_score([TRUE] * 12, [TRUE] * 12, SIZE, kind) for kind in (True, False))
    assert (whole.vot_accuracy, around.vot_accuracy) == (1.0, None)
    assert mean_toolkit_score([whole, around]).vot_accuracy is None


def test_otb_weighs_sequences_alike_got10k_frames_and_vot_lengths() -> None:
    right = toolkit_score([TRUE] * 31, [TRUE] * 31, SIZE)
    wrong = toolkit_score([shifted(80)] * 11, [TRUE] * 11, SIZE)
    mean = mean_toolkit_score([right, wrong])
    assert mean.otb_rate == pytest.approx((1 + 1 / 11) / 2)
    assert mean.got10k_ao == pytest.approx(30 / 40)
    assert mean.vot_accuracy == pytest.approx(31 / 42)
