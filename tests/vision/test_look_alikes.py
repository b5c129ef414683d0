"""Look-alikes are known by their ways through the world, also while nothing is seen of them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.fusion.look_alikes import LookAlikes, Sightings, _explained
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel, CameraView
from follower_vision.geometry.line_of_sight import along_camera_axes, rotation

LENS = CameraModel.from_fov(640, 480, math.radians(70))
INTERVAL_S, RANGE_M, SIDE_PX = 0.1, 20.0, 40.0
SIZE = SIDE_PX * RANGE_M


def looking(yaw: float = 0.0, pitch: float = 0.0, east_m: float = 0.0) -> CameraView:
    turn = along_camera_axes(rotation(0.0, pitch, yaw))
    return CameraView(LENS, turn, np.array([0.0, east_m, -10.0]), math.radians(2))


def image_of(place_m: tuple[float, float, float], view: CameraView) -> Box:
    """A thing of the target's size at a place in the world."""
    away_m = np.array(place_m) - view.place_m
    (x, y), *_ = view.pixels(away_m[None]).tolist()
    side = SIZE / float(np.linalg.norm(away_m))
    return Box(x, y, side, side)


def watched(
    seconds: float, velocity_m_s: float = 0.0, target: float = 1.0, view: CameraView | None = None
) -> LookAlikes:
    """A look-alike 20 m ahead that goes east, seen ten times a second until it is at 0 m."""
    known, view = LookAlikes(), view or looking()
    for number in range(round(seconds / INTERVAL_S), -1, -1):
        known.predict(INTERVAL_S)
        box = image_of((RANGE_M, -number * INTERVAL_S * velocity_m_s, -10.0), view)
        known.update(Sightings.of([box], view, SIZE), target)
    return known


def evidence(known: LookAlikes, *boxes: Box, view: CameraView | None = None) -> list[float]:
    seen = Sightings.of(boxes, view or looking(), SIZE)
    return known.evidence(boxes, seen).tolist()


@given(
    x=st.floats(20, 620),
    y=st.floats(20, 460),
    yaw=st.floats(-3, 3),
    pitch=st.floats(-1, 1),
    range_m=st.floats(3, 80),
)
def test_a_thing_of_the_target_s_size_is_as_far_off_as_it_looks_small(
    x: float, y: float, yaw: float, pitch: float, range_m: float
) -> None:
    view, side = looking(yaw, pitch), SIZE / range_m
    seen = Sightings.of([Box(x, y, side, side)], view, SIZE)
    away_m = seen.places - view.place_m
    assert np.linalg.norm(away_m) == pytest.approx(range_m)
    assert view.pixels(away_m)[0] == pytest.approx([x, y], abs=1e-6)
    along_m = math.sqrt(float(away_m[0] @ seen.noise[0] @ away_m[0])) / range_m
    assert along_m == pytest.approx(0.3 * range_m), "sizes say less of a place than directions"
    assert np.all(np.linalg.eigvalsh(seen.noise[0]) > 0)


def test_nobody_is_known_at_first() -> None:
    assert evidence(LookAlikes(), Box(320, 240, 40, 40)) == [0.0]
    assert LookAlikes().sought(looking()) is None


def test_who_was_seen_beside_the_target_is_not_the_target_and_who_is_elsewhere_may_be() -> None:
    known = watched(1.0)
    here, elsewhere = (image_of((RANGE_M, east, -10), looking()) for east in (0.0, 8.0))
    against = evidence(known, here, elsewhere)
    assert against[0] > 1.5
    assert against[1] == pytest.approx(0.0, abs=0.01)


def test_what_was_never_seen_beside_the_target_may_be_the_target_itself() -> None:
    assert evidence(watched(2.0, target=0.0), image_of((RANGE_M, 0, -10), looking())) == [0.0]


def test_a_look_alike_that_goes_on_behind_a_cover_is_expected_where_it_comes_out() -> None:
    known = watched(3.0, velocity_m_s=1.5)
    for _ in range(20):  # two seconds in which nobody sees it
        known.predict(INTERVAL_S)
    out, behind = (image_of((RANGE_M, east, -10), looking()) for east in (3.0, -3.0))
    against = evidence(known, out, behind)
    assert against[0] > 0.5
    assert against[0] > 4 * against[1]


def test_the_longer_it_is_hidden_the_less_is_known_and_at_last_it_is_forgotten() -> None:
    known, here = watched(2.0), image_of((RANGE_M, 0, -10), looking())
    said = []
    for _ in range(90):
        said += evidence(known, here)
        known.predict(INTERVAL_S)
    assert said == sorted(said, reverse=True)
    assert said[0] > 1.5
    assert said[-1] == 0.0


@pytest.mark.parametrize("yaw", [-0.4, 0.0, 0.4])
def test_it_stays_where_it_is_while_the_camera_turns_and_moves(yaw: float) -> None:
    known, view = watched(1.0), looking(yaw, pitch=-0.2, east_m=3.0)
    here, elsewhere = (image_of((RANGE_M, east, -10), view) for east in (0.0, 9.0))
    against = evidence(known, here, elsewhere, view=view)
    assert against[0] > 1.0 > 0.1 > against[1]


def test_who_a_look_alike_must_be_leaves_the_other_free() -> None:
    """Alone where both may be, either is doubted; with both in sight the nearer one is it."""
    known = watched(1.0)
    near, aside = (image_of((RANGE_M, east, -10), looking()) for east in (0.0, 1.3))
    (alone,) = evidence(known, aside)
    against = evidence(known, near, aside)
    assert alone > against[1] > 0
    assert against[0] > against[1]
    w = np.array([math.expm1(evidence(known, one)[0]) for one in (near, aside)])
    whole = 1 + w.sum()
    assert against == pytest.approx(np.log(whole / (whole - w)).tolist())


def test_each_of_two_look_alikes_speaks_against_another_thing() -> None:
    known = watched(1.0)
    both = [image_of((RANGE_M, east, -10), looking()) for east in (0.0, 6.0)]
    assert evidence(known, *both)[1] < 0.1
    for _ in range(4):
        known.predict(INTERVAL_S)
        known.update(Sightings.of(both[1:], looking(), SIZE), 1.0)
    assert min(evidence(known, *both)) > 1.0


@given(
    st.integers(1, 4).flatmap(
        lambda count: st.lists(
            st.lists(st.floats(0, 1e3), min_size=count, max_size=count), min_size=1, max_size=4
        )
    )
)
def test_all_is_explained_in_so_many_ways(rows: list[list[float]]) -> None:
    """Each thing is at most one look-alike, and each look-alike at most one thing."""
    weights = np.array(rows)
    things, others = weights.shape
    whole = 0.0
    for choice in itertools.product(range(-1, others), repeat=things):
        taken = [one for one in choice if one >= 0]
        if len(set(taken)) == len(taken):
            whole += math.prod(weights[k, one] for k, one in enumerate(choice) if one >= 0)
    assert _explained(weights) == pytest.approx(whole)


def test_boxes_on_one_thing_are_one() -> None:
    known, here = watched(1.0), image_of((RANGE_M, 0, -10), looking())
    again = here.moved_to(here.cx + 4, here.cy)
    against = evidence(known, here, again)
    assert against == pytest.approx([evidence(known, one)[0] for one in (here, again)])


def test_what_turns_out_to_be_the_target_was_no_look_alike() -> None:
    here = image_of((RANGE_M, 0, -10), looking())
    seen = Sightings.of([here], looking(), SIZE)
    guessed, known = watched(1.0, target=0.0), watched(1.0)
    for one in (guessed, known):
        one.leave(seen)
        one.predict(INTERVAL_S)
    assert guessed.sought(looking()) is None
    assert known.sought(looking()) is not None, "the target may pass by"


def test_they_are_looked_for_in_turn_where_they_are_in_the_image() -> None:
    known = watched(1.0)
    other = image_of((RANGE_M, 6, -10), looking())
    known.update(Sightings.of([other], looking(), SIZE), 1.0)
    places = []
    for _ in range(4):
        known.predict(INTERVAL_S)
        sought = known.sought(looking())
        places.append(round(sought[0][0]))
        assert sought[1] == pytest.approx(RANGE_M, rel=0.1)
    assert places == pytest.approx([320, other.cx, 320, other.cx], abs=2)
    assert known.sought(looking(yaw=math.pi)) is None


@given(
    st.lists(st.tuples(st.floats(-9, 9), st.floats(5, 40)), min_size=1, max_size=8),
    st.floats(0, 5),
)
def test_evidence_is_finite_and_never_for_a_candidate(
    places: list[tuple[float, float]], later_s: float
) -> None:
    known = watched(1.0, velocity_m_s=1.0)
    known.predict(later_s)
    against = evidence(known, *(image_of((north, east, -10), looking()) for east, north in places))
    assert np.isfinite(against).all()
    assert min(against) >= 0
