"""What Fusion makes of control's predictions: where its target can be, and where to look for it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from told_trackers import LEVEL, seen

from follower_vision.fusion import FusionSettings
from follower_vision.fusion.box_filter import BoxFilter, FilterNoise
from follower_vision.fusion.candidates import PEAK, PREDICTION, Candidate
from follower_vision.fusion.descriptor import AppearanceMemory, describe
from follower_vision.fusion.features import FEATURES, Situation, measure
from follower_vision.fusion.target import Target, log_sides
from follower_vision.fusion.tracker import doubted
from follower_vision.geometry.box import Box
from follower_vision.trackers.motion_tracker import ResponseMap
from follower_vision.trackers.target_tracker import MotionForecast, TargetPrediction
from follower_vision.trackers.track import TrackState

WIDTH, HEIGHT = 640, 480
IMAGE = np.random.default_rng(4).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
BOX = Box(200, 200, 40, 40)
BESIDE, FAR = BOX.moved_to(300, 200), BOX.moved_to(450, 300)
SETTINGS = FusionSettings()
SIDES = ((0, 0), (40, 0), (-20, 0), (0, 40), (0, -10), (40, -10))
"""Of a region that reaches 20 to the left, 40 to the right, 10 up and 40 down; pixels."""


@pytest.fixture
def target(noise: FilterNoise) -> Target:
    """A target that is seen, ten seconds after the start."""
    size, memory = log_sides(BOX), AppearanceMemory(describe(IMAGE, [BOX], None))
    return Target(BoxFilter(noise, BOX), BOX, size, memory, BOX, 10.0, 10.0)


def around(place: Box, side_px: float) -> Box:
    return Box(place.cx, place.cy, side_px, side_px)


def foretold(place: Box, *formerly: tuple[float, Box]) -> TargetPrediction:
    """A prediction with what was foretold by beliefs of some seconds ago."""
    earlier = tuple(
        MotionForecast(10.0 - age_s, one.cx, one.cy, around(one, 80), 1.0)
        for age_s, one in formerly
    )
    return TargetPrediction(place.cx, place.cy, around(place, 80), around(place, 400), earlier)


def unseen(target: Target, seconds: float) -> Target:
    target.seen_s = target.captured_s - seconds
    target.coast(PREDICTION)
    return target


def test_without_a_prediction_it_can_be_anywhere(target: Target) -> None:
    assert target.can_be_at(FAR)


def test_a_target_that_is_seen_can_be_anywhere_in_the_possible_region(target: Target) -> None:
    target.foreseen = foretold(BOX)
    assert target.can_be_at(BESIDE)
    assert not target.can_be_at(FAR)


@pytest.mark.parametrize(("seconds", "beside"), [(0.3, False), (2.9, False), (3.1, True)])
def test_one_unseen_is_taken_where_it_mostly_is_for_three_seconds(
    target: Target, seconds: float, beside: bool
) -> None:
    target.foreseen = foretold(BOX)
    unseen(target, seconds)
    assert target.can_be_at(BOX.moved_to(210, 200))
    assert target.can_be_at(BESIDE) == beside
    assert not target.can_be_at(FAR)


@pytest.mark.parametrize(
    ("glimpses_s", "found"), [((10.0,), False), ((10.0, 10.2), True), ((10.0, 10.25), False)]
)
def test_in_a_flight_a_lost_target_is_found_by_two_glimpses_soon_after_each_other(
    target: Target, glimpses_s: tuple[float, ...], found: bool
) -> None:
    unseen(target, 3.0)
    target.foreseen = foretold(BOX)
    for target.captured_s in glimpses_s:
        target.observe(Candidate(BOX, PEAK), 0.6)
    assert target.state is (TrackState.TRACKING if found else TrackState.LOST)


def test_on_video_a_lost_target_is_found_by_the_first_glimpse(target: Target) -> None:
    unseen(target, 3.0).observe(Candidate(BOX, PEAK), 0.6)
    assert target.state is TrackState.TRACKING


def test_a_lost_target_is_not_searched_for_where_a_known_look_alike_is(target: Target) -> None:
    target.size_px_m = 20 * BOX.scale
    target.foreseen = replace(foretold(BOX), range_m=20.0, view=LEVEL)
    target.learn_detections([seen(BOX)], 1.0)
    target.learn_look_alikes([seen(BOX), seen(BESIDE)])
    unseen(target, 3.0)
    target.learn_detections([seen(BESIDE), replace(seen(FAR), score=0.4)], 0.1)
    assert target.other_place == FAR
    target.learn_detections([seen(BESIDE)], 0.1)
    assert target.other_place is None
    target.foreseen = None
    target.learn_detections([seen(BESIDE)], 0.1)
    assert target.other_place == BESIDE, "on video nothing is known of the world"


def test_a_place_is_so_many_standard_deviations_from_where_the_target_is_foretold(
    target: Target,
) -> None:
    assert target.deviations(FAR) == (0.0, 0.0), "nothing is foretold"
    place = TargetPrediction(200, 200, Box.from_xywh(180, 190, 60, 50), around(BOX, 400))
    target.foreseen = place
    found = [target.deviations(BOX.moved_to(200 + x, 200 + y))[0] for x, y in SIDES]
    assert found == pytest.approx([0, 2, 2, 2, 2, 2 * math.sqrt(2)])
    target.foreseen = foretold(BOX, (0.4, FAR), (2.0, BESIDE), (2.4, FAR))
    assert target.deviations(BESIDE) == pytest.approx((2 * 100 / 40, 0.0))
    assert target.deviations(FAR)[1] == 0.0, "the nearest of the older forecasts counts"


def test_a_place_speaks_against_a_candidate_by_the_square_of_its_deviation(target: Target) -> None:
    assert target.misplacement(FAR) == 0.0, "nothing is foretold"
    target.foreseen = foretold(BOX, (0.4, BOX), (2.0, BOX))
    odds = [target.misplacement(BOX.moved_to(200 + x, 200)) for x in (0, 20, 40, 60)]
    assert odds == pytest.approx([0, 0.5, 2, 4.5])
    target.foreseen = foretold(BOX)
    assert target.misplacement(BESIDE) == 0.0, "what is followed may be what foretells it"
    unseen(target, 0.3)
    assert target.misplacement(BESIDE) == pytest.approx(0.5 * 5**2)


def test_an_unseen_target_is_where_any_of_the_forecasts_says(target: Target) -> None:
    """The newest may have been led astray just before; all are as probable."""
    before = BOX.moved_to(250, 200)
    target.foreseen = foretold(BOX, (2.0, before))
    unseen(target, 0.3)
    against = [target.misplacement(one) for one in (BOX, before, FAR)]
    half = math.log(2 / (1 + math.exp(-0.5 * 2.5**2)))
    assert against[:2] == pytest.approx([half, half])
    assert against[2] > 15


def test_what_leads_elsewhere_than_was_believed_before_is_not_the_target(target: Target) -> None:
    target.foreseen = foretold(BOX, (0.4, BOX), (2.0, BESIDE), (2.4, BESIDE))
    assert target.misplacement(BOX) == pytest.approx(0.5 * 5**2)
    assert target.misplacement(BESIDE) == 0.0
    unseen(target, 0.3)
    assert target.misplacement(BESIDE) == 0.0


@given(st.floats(0, 1), st.floats(0, 1e6))
def test_evidence_against_a_candidate_takes_its_log_odds_away(p: float, evidence: float) -> None:
    (found,) = doubted(np.full((1, 3), p), np.array([evidence]))
    assert np.isfinite(found).all()
    assert (found <= p).all()
    if 1e-9 < p < 1 - 1e-9 and evidence < 20:
        assert np.log(found / (1 - found)) == pytest.approx(math.log(p / (1 - p)) - evidence)


def test_what_was_believed_before_it_may_have_been_mistaken_still_counts(target: Target) -> None:
    target.foreseen = foretold(BOX, (0.4, FAR))
    assert not target.can_be_at(FAR), "so lately it was as mistaken as now"
    target.foreseen = foretold(BOX, (0.4, BOX), (2.0, FAR))
    assert target.can_be_at(FAR)


def test_half_of_the_looks_are_where_it_was_foretold_before(target: Target) -> None:
    target.foreseen = foretold(BOX, (2.0, FAR), (2.4, FAR))
    places = []
    for looks in range(4):
        target.looks = looks
        region = target.detection_region(SETTINGS, WIDTH, HEIGHT)
        places.append((region.distance(BOX) < 30, region.distance(FAR) < 30))
    assert places == [(True, False)] * 2 + [(False, True)] * 2
    target.foreseen = foretold(BOX, (2.0, BOX.moved_to(230, 200)))
    looks = {target.detection_region(SETTINGS, WIDTH, HEIGHT) for target.looks in range(4)}
    assert len(looks) == 1, "the same place is looked at as ever"


def features_of(target: Target, boxes: list[Box]) -> dict[str, np.ndarray]:
    corners = np.array([[one.left, one.top, one.right, one.bottom] for one in boxes])
    scores = np.ones(len(boxes))
    response = ResponseMap(corners, scores, scores, BOX.scaled(4.0))
    candidates = [Candidate(box, PEAK, rank) for rank, box in enumerate(boxes)]
    seen = describe(IMAGE, boxes, response)
    table = measure(candidates, seen, Situation(target, response, False, [], WIDTH, HEIGHT))
    return {name: table[:, k] for k, name in enumerate(FEATURES) if name.startswith("foreseen")}


def test_the_place_that_older_beliefs_foretell_is_told_from_the_one_that_is_followed(
    target: Target,
) -> None:
    target.foreseen = foretold(BOX, (0.4, BOX), (2.0, FAR), (2.4, FAR))
    found = features_of(target, [BOX, FAR])
    assert found["foreseen"][0] < 0 < found["foreseen"][1]
    assert found["foreseen_lately"][0] < 0 < found["foreseen_lately"][1]
    assert found["foreseen_before"][1] < 0 < found["foreseen_before"][0]
    assert found["foreseen_lead"][1] > 0 > found["foreseen_lead"][0]


def test_where_nothing_is_foretold_nothing_is_said(target: Target) -> None:
    assert all((column == 0).all() for column in features_of(target, [BOX, FAR]).values())
