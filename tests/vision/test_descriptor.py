"""What a box shows, in numbers that can be compared."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_vision.fusion.descriptor import AppearanceMemory, Descriptors, describe
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.motion_tracker import ResponseMap

RNG = np.random.default_rng(4)
IMAGE = RNG.integers(0, 255, (120, 160, 3), np.uint8)
BOX, OTHER = Box(60, 60, 30, 40), Box(120, 60, 30, 40)
SIDES = st.floats(0.5, 400)
BOXES = st.builds(Box, st.floats(-300, 500), st.floats(-300, 500), SIDES, SIDES)


def response(features: np.ndarray | None) -> ResponseMap:
    nothing = np.zeros(1)
    return ResponseMap(np.zeros((1, 4)), nothing, nothing, Box(80, 60, 160, 120), features)


def shifted(image: Image, by: int) -> Image:
    return np.clip(image.astype(int) // 2 + by, 0, 255).astype(np.uint8)


@settings(max_examples=40)
@given(st.lists(BOXES, min_size=1, max_size=4))
def test_descriptors_are_normalised_wherever_the_boxes_lie(boxes: list[Box]) -> None:
    seen = describe(IMAGE, boxes, response(RNG.normal(size=(8, 8, 5))))
    assert seen.patterns.shape == (len(boxes), 576)
    assert seen.features.shape == (len(boxes), 9 * 5)
    for rows in (seen.patterns, seen.features):
        lengths = np.linalg.norm(rows, axis=1)
        assert np.all((lengths < 1e-3) | (np.abs(lengths - 1) < 1e-3))
    assert seen.colours.sum(axis=1) == pytest.approx(1.0)


def test_the_pattern_does_not_depend_on_brightness_or_contrast() -> None:
    memory = AppearanceMemory(describe(IMAGE, [BOX], None))
    likeness = memory.likeness(describe(shifted(IMAGE, 60), [BOX, OTHER], None))
    assert likeness[0, 0] > 0.99
    assert abs(likeness[1, 0]) < 0.3


def test_the_same_view_is_wholly_alike() -> None:
    features = RNG.normal(size=(8, 8, 5))
    seen = describe(IMAGE, [BOX, OTHER], response(features))
    likeness = AppearanceMemory(describe(IMAGE, [BOX], response(features))).likeness(seen)
    assert likeness.shape == (2, 6)
    assert likeness[0] == pytest.approx(1.0, abs=1e-5)
    assert np.all(likeness[1] < 0.9)


def test_without_a_network_the_features_are_no_evidence() -> None:
    seen = describe(IMAGE, [BOX, OTHER], response(None))
    assert seen.features.shape == (2, 0)
    likeness = AppearanceMemory(describe(IMAGE, [BOX], None)).likeness(seen)
    assert not likeness[:, (2, 5)].any()


def test_features_beyond_the_searched_region_are_none() -> None:
    seen = describe(IMAGE, [BOX, Box(400, 60, 30, 40)], response(RNG.normal(size=(8, 8, 5))))
    assert seen.features[0].any()
    assert not seen.features[1].any()


def test_features_are_read_where_the_box_is() -> None:
    """One cell of the map stands out; a box on it has it, one beside it has not."""
    features = RNG.normal(size=(12, 16, 3)) * 0.01
    features[6, 12] += (1.0, -1.0, 0.0)
    on, beside = Box(125, 65, 30, 30), Box(45, 65, 30, 30)
    seen = describe(IMAGE, [on, beside], response(features))
    middle = slice(4 * 3, 5 * 3)
    assert seen.features[0, middle] @ (1.0, -1.0, 0.0) > 1.3
    assert abs(seen.features[1, middle] @ (1.0, -1.0, 0.0)) < 1.0


def learnt(probability: float, times: int) -> np.ndarray:
    """Likeness of a new look to a memory that has been shown it so often."""
    memory = AppearanceMemory(describe(IMAGE, [BOX], None))
    new = describe(IMAGE, [OTHER], None)
    for _ in range(times):
        memory.learn(new, 0, probability)
    return memory.likeness(new)[0]


def test_the_first_view_stays_and_the_recent_one_follows() -> None:
    never, often = learnt(1.0, 0), learnt(1.0, 60)
    assert often[:3] == pytest.approx(never[:3])
    assert often[3] > 0.99
    assert often[4] > 0.99


def test_what_is_improbable_is_learnt_less() -> None:
    assert learnt(0.2, 5)[3] < learnt(0.9, 5)[3] - 0.2


def test_a_view_without_features_leaves_those_that_are_known() -> None:
    features = RNG.normal(size=(8, 8, 5))
    memory = AppearanceMemory(describe(IMAGE, [BOX], response(features)))
    blind = Descriptors(
        describe(IMAGE, [BOX], None).patterns,
        describe(IMAGE, [BOX], None).colours,
        np.zeros((1, 9 * 5)),
    )
    memory.learn(blind, 0, 1.0)
    seen = describe(IMAGE, [BOX], response(features))
    assert memory.likeness(seen)[0, 5] == pytest.approx(1.0, abs=1e-5)
