"""Where Fusion's target might be: peaks, detections, their mean and the prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from follower_vision.detection.detection import Detection
from follower_vision.fusion.candidates import (
    DETECTION,
    MEAN,
    PEAK,
    PREDICTION,
    SECOND,
    Candidate,
    DetectorMemory,
    agreed_box,
    corners_of,
    propose,
)
from follower_vision.geometry.box import Box
from follower_vision.trackers.motion_tracker import MotionEstimate, ResponseMap

BOX = Box(100, 100, 20, 40)
EXPECTED = Box(103, 99, 22, 38)
SIDES = st.floats(2, 300)
BOXES = st.builds(Box, st.floats(-100, 700), st.floats(-100, 500), SIDES, SIDES)
SCORES = st.floats(0, 1)


def response(*sights: tuple[Box, float], penalty: float = 1.0) -> ResponseMap:
    scores = np.array([score for _, score in sights])
    corners = corners_of([box for box, _ in sights])
    return ResponseMap(corners, scores, np.full(len(scores), penalty), BOX.scaled(4))


def seen(box: Box, score: float = 0.9, class_id: int = 0, cut: bool = False) -> Detection:
    return Detection(box, class_id, str(class_id), score, cut)


def of(candidates: list[Candidate], source: str) -> list[Candidate]:
    return [one for one in candidates if one.source == source]


def taught(detected: Box, target: Box, times: int = 3) -> DetectorMemory:
    memory = DetectorMemory()
    for _ in range(times):
        memory.learn([seen(detected)], target, 1.0)
    return memory


def test_the_best_places_come_first_and_none_twice() -> None:
    far, near = BOX.moved_to(200, 100), BOX.moved_to(102, 101)
    found = propose(response((far, 0.6), (BOX, 0.9), (near, 0.8)), [], DetectorMemory(), EXPECTED)
    assert of(found, PEAK) == [Candidate(BOX, PEAK, 0), Candidate(far, PEAK, 1)]
    assert found[-1] == Candidate(EXPECTED, PREDICTION)


def test_a_second_tracker_adds_its_place_and_the_mean_with_the_first() -> None:
    larger = Box(102, 104, 24, 44)
    answer = replace(response((BOX, 0.9)), second=MotionEstimate(larger, 0.7))
    found = propose(answer, [], DetectorMemory(), EXPECTED)
    assert of(found, SECOND) == [Candidate(larger, SECOND)]
    (mean,) = of(found, MEAN)
    assert (mean.box.cx, mean.box.cy) == (101, 102)
    assert mean.box.width * mean.box.height == pytest.approx((20 * 24 * 40 * 44) ** 0.5)
    elsewhere = replace(answer, second=MotionEstimate(BOX.moved_to(300, 100), 0.7))
    assert not of(propose(elsewhere, [], DetectorMemory(), EXPECTED), MEAN)


def test_a_second_place_of_unknown_worth_is_left_out() -> None:
    unsure = replace(response((BOX, 0.9)), second=MotionEstimate(BOX, np.nan))
    assert unsure.finite(EXPECTED).second is None


def test_few_peaks_are_taken_and_no_unlikely_ones() -> None:
    places = [(BOX.moved_to(100 + 50 * k, 100), 0.9 - 0.1 * k) for k in range(8)]
    found = of(propose(response(*places), [], DetectorMemory(), EXPECTED), PEAK)
    assert [one.box.cx for one in found] == [100, 150, 200, 250]
    found = propose(response((BOX, 0.9), (BOX.moved_to(200, 100), 0.02)), [], DetectorMemory(), BOX)
    assert [one.box for one in of(found, PEAK)] == [BOX]


def test_where_nothing_is_likely_the_best_of_it_is_still_a_candidate() -> None:
    found = propose(response((BOX, 0.01)), [], DetectorMemory(), EXPECTED)
    assert of(found, PEAK) == [Candidate(BOX, PEAK)]
    found = propose(response((BOX, 0.0)), [], DetectorMemory(), EXPECTED)
    assert of(found, PEAK) == [Candidate(EXPECTED, PEAK)]


def test_a_peak_and_the_detection_that_overlaps_it_have_a_mean() -> None:
    wide, far = Box(104, 100, 24, 40), Box(300, 100, 24, 40)
    found = propose(response((BOX, 0.9)), [seen(far), seen(wide)], DetectorMemory(), EXPECTED)
    assert {one.box for one in of(found, DETECTION)} == {far, wide}
    (mean,) = of(found, MEAN)
    assert (mean.box.cx, mean.box.cy) == (102, 100)
    assert mean.box.width == pytest.approx(np.sqrt(20 * 24))
    assert of(propose(response((BOX, 0.9)), [seen(far)], DetectorMemory(), EXPECTED), MEAN) == []


def test_detections_of_the_targets_class_come_first() -> None:
    memory = taught(BOX, BOX)
    dim, bright = seen(BOX.moved_to(200, 100), 0.4), seen(BOX.moved_to(300, 100), 0.9, 1)
    found = of(propose(response((BOX, 0.9)), [bright, dim], memory, EXPECTED), DETECTION)
    assert [one.box.cx for one in found] == [200, 300]
    crowd = [seen(BOX.moved_to(200 + 40 * k, 100)) for k in range(9)]
    assert len(of(propose(response((BOX, 0.9)), crowd, memory, EXPECTED), DETECTION)) == 5


@settings(max_examples=40)
@given(st.lists(st.tuples(BOXES, SCORES), min_size=1, max_size=12), BOXES)
def test_the_prediction_comes_last_and_the_first_peak_first(
    sights: list[tuple[Box, float]], expected: Box
) -> None:
    found = propose(response(*sights), [], DetectorMemory(), expected)
    assert found[0].source == PEAK
    assert found[-1] == Candidate(expected, PREDICTION)
    assert [one.rank for one in of(found, PEAK)] == list(range(len(of(found, PEAK))))


def test_boxes_of_one_place_that_are_as_likely_agree_on_their_mean() -> None:
    small, large = Box(100, 100, 20, 40), Box(104, 98, 30, 50)
    agreed = agreed_box([small, large], np.array([2.0, 2.0]), 0)
    assert (agreed.cx, agreed.cy) == pytest.approx((102, 99))
    assert agreed.width == pytest.approx((20 * 30) ** 0.5)
    assert agreed.height == pytest.approx((40 * 50) ** 0.5)


def test_the_less_likely_a_box_is_the_less_it_has_a_say() -> None:
    boxes = [Box(100, 100, 20, 40), Box(104, 98, 30, 50)]
    widths = [agreed_box(boxes, np.array([2.0, merit]), 0).width for merit in (2.0, 1.0, 0.0)]
    assert widths[0] > widths[1] > widths[2] == pytest.approx(20)
    assert agreed_box(boxes, np.zeros(2), 0).width == pytest.approx((20 * 30) ** 0.5)


@settings(max_examples=100)
@given(
    boxes=st.lists(BOXES, min_size=1, max_size=8),
    data=st.data(),
    factor=st.floats(0.5, 2),
    shift=st.floats(-50, 50),
)
def test_only_what_lies_at_the_chosen_place_has_a_say(
    boxes: list[Box], data: st.DataObject, factor: float, shift: float
) -> None:
    merit = np.array(data.draw(st.lists(st.floats(0.1, 3), min_size=8, max_size=8)))[: len(boxes)]
    chosen = data.draw(st.integers(0, len(boxes) - 1))
    assume(all(abs(one.iou(boxes[chosen]) - 0.3) > 1e-6 for one in boxes))
    agreed = agreed_box(boxes, merit, chosen)
    near = [one for one in boxes if one.iou(boxes[chosen]) >= 0.3]
    for name in ("cx", "cy", "width", "height"):
        values = [getattr(one, name) for one in near]
        assert min(values) - 1e-6 <= getattr(agreed, name) <= max(values) + 1e-6
    moved = [
        Box(one.cx * factor + shift, one.cy * factor, one.width * factor, one.height * factor)
        for one in boxes
    ]
    again = agreed_box(moved, merit, chosen)
    assert again.cx == pytest.approx(agreed.cx * factor + shift, abs=1e-6)
    assert again.height == pytest.approx(agreed.height * factor)


def test_the_detectors_box_becomes_the_targets() -> None:
    """The target is the upper half of what the detector sees, also farther away and smaller."""
    memory = taught(Box(100, 120, 20, 80), Box(100, 100, 20, 40))
    assert memory.corrected(seen(Box(300, 200, 10, 40))).xywh == pytest.approx((295, 180, 10, 20))


def test_a_box_cut_by_the_edge_tells_nothing_of_sizes() -> None:
    memory = DetectorMemory()
    memory.learn([seen(Box(100, 90, 20, 30), cut=True)], BOX, 1.0)
    whole = Box(200, 100, 20, 40)
    assert memory.corrected(seen(whole)) == whole


def test_one_wrong_box_among_many_hardly_matters() -> None:
    memory = taught(BOX, BOX, times=20)
    memory.learn([seen(BOX.scaled(1.3))], BOX, 1.0)
    assert memory.corrected(seen(BOX)).width == pytest.approx(BOX.width, rel=0.03)


def test_classes_count_by_what_was_seen_at_the_target() -> None:
    memory = DetectorMemory()
    assert memory.class_share(seen(BOX)) == 0
    for kind in (0, 0, 0, 1):
        memory.learn([seen(BOX, class_id=kind)], BOX, 1.0)
    assert memory.class_share(seen(BOX)) == pytest.approx(0.75)
    memory.learn([seen(BOX.moved_to(300, 100), class_id=2)], BOX, 1.0)
    assert memory.class_share(seen(BOX, class_id=2)) == 0


def test_it_remembers_how_often_the_target_was_detected_and_how_long_not() -> None:
    memory = taught(BOX, BOX, times=60)
    assert memory.hits == pytest.approx(1.0, abs=0.01)
    for _ in range(3):
        memory.learn([seen(BOX.moved_to(300, 100))], BOX, 1.0)
    assert memory.silence == 3
    assert 0.5 < memory.hits < 0.9
    memory.learn([seen(BOX)], BOX, 1.0)
    assert memory.silence == 0
