"""What speaks for and against a candidate: finite whatever comes, and without dimension."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_vision.detection.detection import Detection
from follower_vision.fusion.box_filter import BoxFilter, FilterNoise
from follower_vision.fusion.candidates import SECOND, SOURCES, Candidate, corners_of, propose
from follower_vision.fusion.descriptor import AppearanceMemory, describe
from follower_vision.fusion.features import FEATURES, Situation, measure
from follower_vision.fusion.target import Target, log_sides
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.motion_tracker import MotionEstimate, ResponseMap

NOISE = FilterNoise(6.0, 0.2, dict.fromkeys(SOURCES, 0.05), dict.fromkeys(SOURCES, 0.08))
WIDTH, HEIGHT = 160, 120
IMAGE = np.random.default_rng(2).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
BOX = Box(80, 60, 20, 24)
NEAR, FAR = Box(82, 61, 21, 23), Box(130, 40, 19, 24)
Sight = tuple[Box, float]

SIDES = st.floats(0.5, 400)
BOXES = st.builds(Box, st.floats(-300, 500), st.floats(-300, 500), SIDES, SIDES)
SCORES = st.floats(0, 1)
DETECTIONS = st.builds(Detection, BOXES, st.integers(0, 3), st.just("thing"), SCORES)


def response(sights: list[Sight], penalty: float = 0.9, channels: int = 0) -> ResponseMap:
    scores = np.array([score for _, score in sights])
    corners = corners_of([box for box, _ in sights])
    features = None
    if channels:
        features = np.random.default_rng(3).normal(size=(8, 8, channels))
    region = sights[0][0].scaled(4)
    return ResponseMap(corners, scores, np.full(len(scores), penalty), region, features)


def target(image: Image, box: Box, answer: ResponseMap) -> Target:
    """A target as it is when it was just chosen."""
    memory = AppearanceMemory(describe(image, [box], answer))
    size = log_sides(box)
    return Target(BoxFilter(NOISE, box), box, size, memory, box, 0.0, 0.0)


def table(
    known: Target,
    image: Image,
    answer: ResponseMap,
    detections: list[Detection],
    candidates: list[Candidate] | None = None,
) -> np.ndarray:
    found = candidates or propose(answer, detections, known.detector, known.filter.box)
    seen = describe(image, [one.box for one in found], answer)
    height, width = image.shape[:2]
    situation = Situation(known, answer, bool(detections), detections, width, height)
    return measure(found, seen, situation)


def test_a_second_tracker_speaks_for_its_place_and_for_what_overlaps_it() -> None:
    alone = response([(NEAR, 0.9), (FAR, 0.6)])
    known = target(IMAGE, BOX, alone)
    names = ("is_second", "second_iou", "second_score", "second_peak_iou")
    columns = [FEATURES.index(name) for name in names]
    assert not table(known, IMAGE, alone, [])[:, columns].any()
    both = dataclasses.replace(alone, second=MotionEstimate(FAR, 0.4))
    found = propose(both, [], known.detector, known.filter.box)
    rows = table(known, IMAGE, both, [], found)[:, columns]
    for one, row in zip(found, rows, strict=True):
        own = float(one.source == SECOND)
        assert row == pytest.approx([own, one.box.iou(FAR), 0.4, NEAR.iou(FAR)])


def scene(scale: int = 1) -> np.ndarray:
    """A target that goes right past a look-alike, all of it so many times as large."""

    def at(box: Box) -> Box:
        return Box(*(scale * value for value in (box.cx, box.cy, box.width, box.height)))

    image = np.repeat(np.repeat(IMAGE, scale, axis=0), scale, axis=1)
    answer = response([(at(NEAR), 0.9), (at(FAR), 0.6)])
    known = target(image, at(BOX), answer)
    known.detector.learn([Detection(at(BOX.scaled(1.2)), 0, "thing", 0.8)], at(BOX), 1.0)
    for _ in range(3):
        known.advance(known.captured_s + 0.1)
        known.distractors.update(at(BOX), [at(FAR)], np.array([0.4]), np.zeros((1, 0)), np.zeros(1))
        known.filter.observe(at(NEAR), "peak", 0.9)
    known.advance(known.captured_s + 0.1)
    detections = [Detection(at(NEAR.scaled(1.2)), 0, "thing", 0.7)]
    return table(known, image, answer, detections)


def column(values: np.ndarray, name: str) -> np.ndarray:
    return values[:, FEATURES.index(name)]


@settings(max_examples=40)
@given(
    box=BOXES,
    sights=st.lists(st.tuples(BOXES, SCORES), min_size=1, max_size=6),
    detections=st.lists(DETECTIONS, max_size=4),
    intervals_s=st.lists(st.floats(0, 5), min_size=1, max_size=4),
    channels=st.sampled_from([0, 4]),
)
def test_whatever_is_seen_the_features_are_finite(
    box: Box,
    sights: list[Sight],
    detections: list[Detection],
    intervals_s: list[float],
    channels: int,
) -> None:
    answer = response(sights, channels=channels)
    known = target(IMAGE, box, answer)
    for interval_s in intervals_s:
        known.advance(known.captured_s + interval_s)
        known.filter.keep_within(WIDTH, HEIGHT)
        found = propose(answer, detections, known.detector, known.filter.box)
        values = table(known, IMAGE, answer, detections, found)
        assert values.shape == (len(found), len(FEATURES))
        assert np.isfinite(values).all()
        assert np.abs(values).max() < 100
        seen = describe(IMAGE, [one.box for one in found], answer)
        known.observe(found[0], 0.7)
        known.learn_appearance(seen, 0, 0.7)
        known.learn_detections(detections, 0.7)
        boxes = [one.box for one in found]
        half, none = np.full(len(boxes), 0.5), np.zeros(len(boxes))
        known.distractors.update(known.box, boxes, half, seen.features, none)


def test_a_picture_without_any_structure_has_finite_features() -> None:
    flat = np.full_like(IMAGE, 90)
    answer = response([(NEAR, 0.9)], channels=4)
    assert np.isfinite(table(target(flat, BOX, answer), flat, answer, [])).all()


@pytest.mark.parametrize("scale", [2, 3])
def test_the_same_scene_larger_has_the_same_features_but_for_the_scale(scale: int) -> None:
    usual, larger = scene(), scene(scale)
    grown = column(larger, "scale") - column(usual, "scale")
    assert grown == pytest.approx(0.2 * np.log(scale))
    pictured = ("correlation", "colours")  # the same, but sampled a little differently
    for place, name in enumerate(FEATURES):
        if name != "scale":
            within = 0.12 if name.startswith(pictured) else 1e-6
            assert larger[:, place] == pytest.approx(usual[:, place], abs=within), name


def test_each_candidate_is_of_one_source() -> None:
    values = scene()
    kinds = [name for name in FEATURES if name.startswith("is_")]
    assert np.sum([column(values, name) for name in kinds], axis=0) == pytest.approx(1.0)
    assert column(values, "is_prediction")[-1] == 1
    assert column(values, "is_first_peak")[0] == 1


def test_the_motion_trackers_word_is_told_by_place_and_beside_the_best_elsewhere() -> None:
    answer = response([(NEAR, 0.9), (FAR, 0.6)])
    values = table(target(IMAGE, BOX, answer), IMAGE, answer, [])
    support, margin = column(values, "support"), column(values, "margin")
    assert support[:2] == pytest.approx([0.9 * 0.9, 0.6 * 0.9])
    assert margin[:2] == pytest.approx([0.3 * 0.9, -0.3 * 0.9])
    assert column(values, "best_support") == pytest.approx(0.9 * 0.9)


def test_the_detectors_word_is_told_by_place() -> None:
    answer = response([(NEAR, 0.9), (FAR, 0.6)])
    known = target(IMAGE, BOX, answer)
    known.detector.learn([Detection(BOX, 0, "thing", 0.8)], BOX, 1.0)
    values = table(known, IMAGE, answer, [Detection(NEAR, 0, "thing", 0.7)])
    peaks = slice(0, 2)
    assert column(values, "detected_score")[peaks] == pytest.approx([0.7, 0.0])
    assert column(values, "detected_class")[peaks] == pytest.approx([1.0, 0.0])
    assert column(values, "detections_elsewhere")[peaks] == pytest.approx([0.0, 0.7])
    unasked = table(known, IMAGE, answer, [])
    assert not column(unasked, "looked").any()
    assert column(values, "looked").all()


def test_who_looks_more_alike_than_the_one_beside_it_leads() -> None:
    answer = response([(NEAR, 0.9), (FAR, 0.6)])
    known = target(IMAGE, BOX, answer)
    candidates = [Candidate(BOX, "peak"), Candidate(FAR, "peak", 1), Candidate(BOX, "prediction")]
    values = table(known, IMAGE, answer, [], candidates)
    lead = column(values, "correlation_lead")
    assert lead[0] > 0.5
    assert lead[0] == pytest.approx(-lead[1])


def test_the_longer_unseen_the_larger_is_unseen_and_the_spread() -> None:
    answer = response([(NEAR, 0.9)])
    known = target(IMAGE, BOX, answer)
    tables = []
    for _ in range(4):
        known.advance(known.captured_s + 0.2)
        tables.append(table(known, IMAGE, answer, []))
    for name in ("unseen", "spread"):
        assert np.all(np.diff([column(one, name)[0] for one in tables]) > 0)
