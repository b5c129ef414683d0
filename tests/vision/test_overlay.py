"""Overlay and labels at any size; the frame is not touched, labels stand off each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.drawing.overlay import STATE_COLOURS, draw_tracks, place_labels, target_colour
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import Track, TrackState


def grey(width: int, height: int) -> np.ndarray:
    return np.full((height, width, 3), 110, np.uint8)


def track(box: Box, state: TrackState = TrackState.TRACKING) -> Track:
    return Track(box, state, 0.87, "correlation", 1.0, 30)


def near(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    return np.abs(image.astype(int) - colour).sum(axis=2) < 150


@pytest.mark.parametrize("state", list(TrackState))
@pytest.mark.parametrize(("width", "height"), [(320, 240), (640, 480), (1280, 720)])
def test_the_box_is_drawn_in_its_states_colour_where_it_is(width, height, state):
    box = Box.from_xywh(0.3 * width, 0.4 * height, 0.2 * width, 0.25 * height)
    drawn = draw_tracks(grey(width, height), [track(box, state)])
    columns = np.flatnonzero(near(drawn, STATE_COLOURS[state])[round(box.cy) + 12])
    assert abs(columns.min() + 0.5 - box.left) < 3
    assert abs(columns.max() + 0.5 - box.right) < 3


def test_the_frame_itself_is_left_alone():
    image = grey(320, 240)
    draw_tracks(image, [track(Box(100, 100, 40, 30))], ["a line"])
    assert (image == 110).all()


def test_without_a_track_only_the_centre_and_the_text_are_drawn():
    drawn = draw_tracks(grey(320, 240), [], ["IDLE"])
    changed = np.argwhere((drawn != 110).any(axis=2))
    in_text = (changed[:, 0] < 40) & (changed[:, 1] < 100)
    in_centre = (abs(changed[:, 0] - 120) < 20) & (abs(changed[:, 1] - 160) < 20)
    assert in_text.any()
    assert in_centre.any()
    assert (in_text | in_centre).all()


@pytest.mark.parametrize(
    "box",
    [
        Box(0, 0, 30, 20),
        Box(320, 240, 30, 20),
        Box(-500, 100, 30, 20),
        Box(160, 120, 2000, 2000),
        Box(160, 120, 1e7, 1e7),
        Box(160, 120, 0.01, 0.01),
        Box(1e9, -1e9, 5, 5),
    ],
)
def test_boxes_anywhere_and_of_any_size_do_no_harm(box):
    drawn = draw_tracks(grey(320, 240), [track(box)], ["x" * 200])
    assert drawn.shape == (240, 320, 3)


def test_tiny_images_do_no_harm():
    assert draw_tracks(grey(16, 8), [track(Box(8, 4, 4, 2))], ["line", "line"]).shape == (8, 16, 3)


def test_several_targets_have_a_colour_each_and_the_unseen_show_their_corners_alone():
    boxes = [Box(100 + 150 * number, 120, 80, 80) for number in range(4)]
    states = [TrackState.TRACKING, TrackState.TRACKING, TrackState.COASTING, TrackState.LOST]
    tracks = [track(box, state) for box, state in zip(boxes, states, strict=True)]
    drawn = draw_tracks(grey(700, 480), tracks)
    for number, (box, state) in enumerate(zip(boxes, states, strict=True), 1):
        coloured = near(drawn, target_colour(number))
        left = coloured[:, round(box.left) - 1 : round(box.left) + 2].any(axis=1)
        assert left[round(box.top) + 5]
        assert left[round(box.cy)] == (state is TrackState.TRACKING)


SIZE = (100.0, 20.0)


def test_a_label_stands_above_its_box_and_below_it_at_the_upper_edge():
    ((left, top),) = place_labels([Box.from_xywh(50, 100, 30, 40)], [SIZE], 640, 480)
    assert left == 50
    assert 70 < top < 80
    ((_, top),) = place_labels([Box.from_xywh(50, 5, 30, 40)], [SIZE], 640, 480)
    assert top > 45


def test_a_label_does_not_stand_where_the_lines_of_text_do():
    text = Box.from_xywh(8, 8, 300, 60)
    box = Box.from_xywh(50, 80, 30, 40)
    ((left, top),) = place_labels([box], [SIZE], 640, 480, [text])
    assert Box.from_xywh(left, top, *SIZE).intersection(text) == 0
    assert Box.from_xywh(left, top, *SIZE).distance(box) < 100


def test_labels_of_neighbours_do_not_cover_each_other_or_the_boxes():
    boxes = [Box.from_xywh(200 + 25 * number, 200, 20, 40) for number in range(4)]
    corners = place_labels(boxes, [SIZE] * 4, 640, 480)
    labels = [Box.from_xywh(left, top, *SIZE) for left, top in corners]
    for index, label in enumerate(labels):
        assert all(label.intersection(other) == 0 for other in labels[:index])
        assert all(label.intersection(box) == 0 for box in boxes)


coordinate = st.floats(-1e6, 1e6)


@given(st.lists(st.tuples(coordinate, coordinate, st.floats(0.01, 1e5)), max_size=6))
def test_every_label_begins_inside_the_image(places):
    boxes = [Box(x, y, side, side) for x, y, side in places]
    for left, top in place_labels(boxes, [SIZE] * len(boxes), 320, 240):
        assert 0 <= left <= 220
        assert 0 <= top <= 220
