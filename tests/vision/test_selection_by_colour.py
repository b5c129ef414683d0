"""A described target is found in the pixels, tightly, and nothing else is."""

import cv2
import numpy as np
import pytest

from follower_vision.geometry.box import Box
from follower_vision.selection import ColourSearchSettings, colour_from_hex, find_by_colour

ORANGE = (30, 90, 255)


def fields(width: int = 640, height: int = 480, seed: int = 0) -> np.ndarray:
    """Duller fields in greens, ochres and reddish browns, a grey road, camera noise."""
    rng = np.random.default_rng(seed)
    image = np.empty((height, width, 3), np.uint8)
    dull = [(60, 110, 90), (70, 120, 150), (60, 80, 120), (90, 100, 100), (50, 90, 70)]
    for row in range(0, height, 80):
        for column in range(0, width, 128):
            image[row : row + 80, column : column + 128] = dull[rng.integers(len(dull))]
    cv2.line(image, (0, 300), (width, 180), (105, 105, 105), 60)
    noise = rng.normal(0, 6, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def draw_car(image: np.ndarray, box: Box) -> None:
    """A car from behind and above: lit roof, shaded back, dark rear window and wheels."""
    x, y, w, h = (round(v) for v in box.xywh)
    image[y : y + h, x : x + w] = (15, 50, 150)
    image[y : y + round(0.45 * h), x : x + w] = ORANGE
    window = slice(y + round(0.3 * h), y + round(0.5 * h))
    image[window, x + round(0.1 * w) : x + round(0.9 * w)] = (60, 50, 45)
    image[y + round(0.87 * h) : y + h, x : x + w] = (35, 35, 35)


@pytest.mark.parametrize("size", [(10, 8), (25, 15), (60, 45), (200, 140)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_orange_car_among_dull_fields_is_found_with_a_tight_box(size, seed):
    image = fields(seed=seed)
    truth = Box.from_xywh(300, 230, *size)
    draw_car(image, truth)
    found = find_by_colour(image, ORANGE)
    assert found[0].iou(truth) > 0.75
    assert len(found) == 1


def test_wheels_are_taken_in():
    image = fields()
    truth = Box.from_xywh(300, 230, 60, 45)
    draw_car(image, truth)
    coloured = find_by_colour(image, ORANGE, ColourSearchSettings(max_growth_ratio=0.0))[0]
    grown = find_by_colour(image, ORANGE)[0]
    assert coloured.bottom < truth.bottom - 3
    assert grown.bottom == pytest.approx(truth.bottom, abs=1)


def test_the_purer_and_larger_blob_comes_first():
    image = fields()
    near, far = Box.from_xywh(100, 230, 40, 24), Box.from_xywh(500, 220, 12, 8)
    draw_car(image, near)
    draw_car(image, far)
    found = find_by_colour(image, ORANGE)
    assert [box.iou(truth) > 0.6 for box, truth in zip(found, (near, far), strict=True)] == [1, 1]


def test_a_small_part_upon_a_large_one_is_no_target_of_its_own():
    """As the cabin's roof of a boat is, whose white walls part it from the hull's sides."""
    image = fields()
    truth = Box.from_xywh(300, 230, 60, 60)
    for side in (truth.left, truth.right - 12):
        image[230:290, round(side) : round(side) + 12] = ORANGE
    image[284:290, 300:360] = ORANGE
    image[234:238, 320:340] = ORANGE
    found = find_by_colour(image, ORANGE)
    assert len(found) == 1
    assert found[0].iou(truth) > 0.75


def test_nothing_is_found_where_nothing_has_the_colour():
    assert find_by_colour(fields(), ORANGE) == []
    assert find_by_colour(np.zeros((480, 640, 3), np.uint8), ORANGE) == []


def test_a_cast_over_the_whole_image_is_no_target():
    assert find_by_colour(np.full((480, 640, 3), ORANGE, np.uint8), ORANGE) == []


@pytest.mark.parametrize(
    ("colour", "wanted"),
    [
        ((20, 10, 220), (15, 15, 220)),
        ((10, 20, 220), (15, 15, 220)),
        ((240, 240, 240), (235, 235, 235)),
    ],
    ids=["red before the hue circle's end", "red behind it", "a white van, by brightness"],
)
def test_a_colour_is_found_on_both_sides_of_the_hue_circle_and_without_a_hue(colour, wanted):
    image = fields()
    image[100:130, 200:240] = colour
    assert find_by_colour(image, wanted)[0].iou(Box.from_xywh(200, 100, 40, 30)) > 0.8


def test_a_target_at_the_images_edge_is_found():
    image = fields()
    draw_car(image, Box.from_xywh(-10, 230, 60, 45).moved_to(30, 252.5))
    assert find_by_colour(image, ORANGE)[0].left <= 1


@pytest.mark.parametrize("text", ["ff5a1e", "#FF5a1e"])
def test_a_colour_is_read_from_hex(text):
    assert colour_from_hex(text) == (0x1E, 0x5A, 0xFF)


@pytest.mark.parametrize("text", ["orange", "#ff5a1", "#gg0000", ""])
def test_what_is_no_colour_is_refused(text):
    with pytest.raises(ValueError, match="rrggbb"):
        colour_from_hex(text)
