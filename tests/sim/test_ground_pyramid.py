"""The ground's maps in one image: every map is found again, and the far ground never ends."""

import numpy as np
import pytest

from follower_sim.world.ground_pyramid import GroundMap, GroundPyramid, Plane

NORTH_M, EAST_M = 40.0, -25.0


def maps(height: int, width: int, count: int = 3) -> list[GroundMap]:
    """Maps of noise, each half as fine as the one before."""
    noise = np.random.default_rng(7).integers(0, 256, (height, width, 3), dtype=np.uint8)
    found = [GroundMap(noise, NORTH_M, EAST_M, 0.5)]
    while len(found) < count:
        found.append(found[-1].halved())
    return found


def middles(one: GroundMap) -> tuple[Plane, Plane]:
    """How far south and east of the upper left corner the middles of a map's pixels are."""
    rows, columns = np.indices(one.image.shape[:2], np.float32)
    size = np.float32(one.m_per_px)
    return (rows + np.float32(0.5)) * size, (columns + np.float32(0.5)) * size


@pytest.mark.parametrize("shape", [(60, 40), (40, 60), (37, 53), (64, 64)])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_each_map_is_found_pixel_by_pixel(shape: tuple[int, int], level: int) -> None:
    several = maps(*shape)
    pyramid, places = GroundPyramid(several), middles(several[level])
    everywhere = np.full(places[0].shape, level, np.uint8)
    assert np.array_equal(pyramid.look(*places, level), several[level].image)
    assert np.array_equal(pyramid.look(*places, everywhere), several[level].image)


def test_one_look_sees_several_maps_side_by_side() -> None:
    several = maps(60, 40)
    south, across = middles(several[0])
    levels = np.zeros(south.shape, np.uint8)
    levels[30:] = 2
    seen = GroundPyramid(several).look(south, across, levels)
    assert np.array_equal(seen[:30], several[0].image[:30])
    coarse = GroundPyramid(several[2:]).look(south, across, 0)
    assert np.array_equal(seen[30:], coarse[30:])


def test_at_its_edges_a_map_shows_nothing_of_its_neighbours() -> None:
    white = [
        GroundMap(np.full((side, side, 3), shade, np.uint8), NORTH_M, EAST_M, 32 / side)
        for side, shade in ((64, 200), (32, 100), (16, 50))
    ]
    pyramid = GroundPyramid(white)
    ends = np.array([[0, 0, 32, 32]], np.float32), np.array([[0, 32, 0, 32]], np.float32)
    for level, shade in enumerate((200, 100, 50)):
        assert (pyramid.look(*ends, level) == shade).all()


def test_a_place_is_covered_up_to_the_end_of_the_shortest_map() -> None:
    pyramid = GroundPyramid(maps(37, 53))
    assert (pyramid.south_m, pyramid.across_m) == (18.0, 26.0)
    inside = np.array([[0.0, 18.0]], np.float32), np.array([[26.0, 0.0]], np.float32)
    beyond = np.array([[0.0, 18.1]], np.float32), np.array([[26.0, -0.1]], np.float32)
    assert pyramid.covers(*inside) is None
    covered = pyramid.covers(*beyond)
    assert covered.tolist() == [[255, 0]]


def test_beyond_its_edges_ground_goes_on_mirrored() -> None:
    pyramid = GroundPyramid(maps(60, 40))
    south = np.array([[-3.0, 33.0, 57.0, 61.0, -59.0]], np.float32)
    across = np.array([[-1.0, 21.0, 39.5, 40.5, 400.25]], np.float32)
    down, right = pyramid.mirrored(south, across)
    assert down == pytest.approx(np.array([[3.0, 27.0, 3.0, 1.0, 1.0]]))
    assert right == pytest.approx(np.array([[1.0, 19.0, 0.5, 0.5, 0.25]]))
