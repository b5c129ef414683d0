"""The polygon fence: which places are inside, and which ways are open there."""

import cmath
import math

import hypothesis.strategies as st
import pytest
from hypothesis import assume, given

from follower_control.envelope.fence import Fence

SQUARE = ((0.0, 0.0), (0.0, 40.0), (40.0, 40.0), (40.0, 0.0))
NOTCHED = ((-30.0, -30.0), (-30.0, 30.0), (30.0, 30.0), (0.0, 0.0), (30.0, -30.0))
"""A square with a notch in its north side, whose deepest point is the origin."""

U_SHAPED = (
    *((-60.0, -60.0), (-60.0, 60.0), (60.0, 60.0), (60.0, 20.0)),
    *((20.0, 20.0), (20.0, 10.0), (60.0, 10.0), (60.0, -60.0)),
)
"""Two of its sides lie on one line, and do not touch."""

number = st.floats(-60, 60)
places = st.builds(complex, number, number)
within = st.builds(complex, st.floats(-29, 29), st.floats(-29, 29))


def inside_by_angle(corners, place: complex) -> bool:
    """By the winding number: another way to the same answer."""
    points = [complex(*corner) - place for corner in corners]
    turns = (cmath.phase(b / a) for a, b in zip(points, [*points[1:], points[0]], strict=True))
    return abs(sum(turns)) > math.pi


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1], NOTCHED, NOTCHED[::-1], U_SHAPED])
@given(place=places)
def test_inside_is_inside_whichever_way_the_corners_turn(corners, place: complex) -> None:
    fence = Fence(corners)
    assume(fence.distance_m(place) > 1e-3)
    assert fence.contains(place) == inside_by_angle(corners, place)


@pytest.mark.parametrize("corners", [SQUARE, NOTCHED])
@given(place=within, velocity=places, step_s=st.floats(0.001, 0.1))
def test_what_the_bounds_allow_never_leads_out(corners, place, velocity, step_s) -> None:
    """A speed of at most distance over time: whatever keeps it is inside after that time."""
    fence = Fence(corners)
    place = place if corners is NOTCHED else abs(place.real) + 1j * abs(place.imag)
    assume(fence.contains(place))
    bounds = fence.bounds(place, 0.0, lambda room_m: max(room_m, 0.0) / step_s)
    share = min(bound.share(velocity) for bound in bounds)
    moved = place + 0.999 * share * velocity * step_s
    assert fence.contains(moved) or fence.distance_m(moved) < 1e-5


@pytest.mark.parametrize("corners", [SQUARE, NOTCHED])
@given(place=places, velocity=places)
def test_outside_only_ways_back_are_open(corners, place: complex, velocity: complex) -> None:
    fence = Fence(corners)
    assume(not fence.contains(place) and fence.distance_m(place) > 0.01)
    bounds = fence.bounds(place, 1.0, lambda _: 5.0)
    if all(bound.excess(velocity) <= 0 for bound in bounds) and abs(velocity) > 1e-6:
        step = 0.001 * velocity / abs(velocity)
        assert fence.distance_m(place + step) < fence.distance_m(place) or fence.contains(
            place + step
        )


@given(place=places)
def test_outside_there_is_a_way_back(place: complex) -> None:
    fence = Fence(NOTCHED)
    assume(not fence.contains(place) and fence.distance_m(place) > 0.01)
    back = -fence.bounds(place, 1.0, lambda _: 5.0)[0].direction
    assert all(bound.share(3.0 * back) == 1.0 for bound in fence.bounds(place, 1.0, lambda _: 5.0))


def test_corners_by_latitude_and_longitude_are_the_same_fence() -> None:
    """A thousandth of a degree is 111.2 m to the north, and less to the east."""
    origin = 60.0, 10.0
    corners = ((60.0, 10.0), (60.0, 10.001), (60.001, 10.001), (60.001, 10.0))
    fence = Fence.around(origin, corners)
    north, east = 111.195, 111.195 * math.cos(math.radians(60))
    assert fence.contains(complex(0.5 * north, 0.5 * east))
    assert fence.distance_m(complex(-10.0, 0.5 * east)) == pytest.approx(10.0)
    assert fence.distance_m(complex(0.5 * north, -7.0)) == pytest.approx(7.0)
    assert fence.distance_m(complex(0.5 * north, east + 5.0)) == pytest.approx(5.0, rel=0.01)


def test_a_fence_across_the_180th_meridian_is_like_any_other() -> None:
    corners = ((10.0, 179.9), (10.0, -179.9), (10.2, -179.9), (10.2, 179.9))
    moved = tuple((latitude, longitude % 360 - 170.0) for latitude, longitude in corners)
    there = Fence.around((10.1, -179.95), corners)
    elsewhere = Fence.around((10.1, 10.05), moved)
    assert there.contains(0j)
    assert not there.contains(complex(0, 10_000))
    for place in (0j, complex(0, 10_000), complex(5000, -3000)):
        assert there.distance_m(place) == pytest.approx(elsewhere.distance_m(place))


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        (((0, 0), (1, 0)), "at least three"),
        (((0, 0), (0, 10), (10, 0), (10, 10)), "cross"),
        (((0, 0), (0, 30), (10, 30), (0, 20), (0, 10), (10, 0)), "cross"),
        (((0, 0), (0, 0), (10, 0), (10, 10)), "the same"),
        (((0, 0), (5, 5), (10, 10)), "encloses nothing"),
        (((0, 0), (math.nan, 5), (10, 10)), "finite"),
    ],
)
def test_what_is_no_polygon_is_refused(corners, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Fence(corners)
