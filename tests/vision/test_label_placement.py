"""Labels stand in the image, beside their boxes, and off each other where there is room."""

from hypothesis import given
from hypothesis import strategies as st

from follower_vision.drawing.overlay import place_labels
from follower_vision.geometry.box import Box

SIZE = (100.0, 20.0)


def test_a_label_stands_above_its_box_and_below_it_at_the_upper_edge():
    ((left, top),) = place_labels([Box.from_xywh(50, 100, 30, 40)], [SIZE], 640, 480)
    assert left == 50
    assert 70 < top < 80
    ((_, top),) = place_labels([Box.from_xywh(50, 5, 30, 40)], [SIZE], 640, 480)
    assert top > 45


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
