"""Non-maximum suppression keeps the best and no two that overlap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.geometry.box import Box, keep_best, pairwise_iou

side = st.integers(1, 60)
boxes = st.lists(st.tuples(st.integers(0, 80), st.integers(0, 80), side, side), max_size=25)


def corners_of(rows: list[tuple[int, int, int, int]]) -> np.ndarray:
    xywh = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return np.hstack([xywh[:, :2], xywh[:, :2] + xywh[:, 2:]])


@given(boxes)
def test_pairwise_iou_is_that_of_boxes(rows: list[tuple[int, int, int, int]]) -> None:
    made = [Box.from_xywh(*row) for row in rows]
    expected = np.array([[one.iou(other) for other in made] for one in made])
    found = pairwise_iou(corners_of(rows), corners_of(rows))
    np.testing.assert_allclose(found, expected.reshape(len(rows), len(rows)), atol=1e-12)


@given(boxes, st.randoms(use_true_random=False), st.floats(0.05, 0.95))
def test_kept_ones_do_not_overlap_and_dropped_ones_do(rows, random, overlap) -> None:
    corners = corners_of(rows)
    scores = np.array([random.uniform(0.01, 1.0) for _ in rows], np.float32)  # as networks give
    kept = keep_best(corners, scores, overlap, most=len(rows))
    iou = pairwise_iou(corners, corners)
    assert list(scores[kept]) == sorted(scores[kept], reverse=True)
    assert all(iou[a, b] <= overlap + 1e-9 for a in kept for b in kept if a != b)
    for dropped in set(range(len(rows))) - set(kept):
        better = [index for index in kept if scores[index] >= scores[dropped]]
        assert max(iou[dropped, index] for index in better) > overlap - 1e-9


@pytest.mark.parametrize("most", [1, 2, 3])
def test_keeps_no_more_than_asked(most: int) -> None:
    corners = corners_of([(0, 0, 5, 5), (20, 0, 5, 5), (40, 0, 5, 5)])
    assert keep_best(corners, np.array([0.1, 0.9, 0.5]), 0.5, most) == [1, 2, 0][:most]
