"""The ground's colours as maps, generated once from a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.ground_map import GroundMap
from follower_sim.ground_pyramid import Ground, GroundPyramid
from follower_sim.mesh import Colour
from follower_sim.noise import Grey, layered_noise
from follower_sim.roads import Road, paint_road, paint_shadows, paint_strip, road_mask
from follower_sim.scenario import GroundSettings
from follower_vision.camera import Vector
from follower_vision.frame import Image

FAR_EXTENT_M = 2400.0
_FAR_M_PER_PX = 1.0
_MOST_PIXELS = 18e6


@dataclass(frozen=True, slots=True)
class Palette:
    """Colours of a kind of ground.

    Attributes:
        patches: colours of its fields or patches.
        patch_m: their size.
        relief: how strongly small structure shows, 1 is grass.
        haze: colour of the far distance.
        verge: colour of the edges of roads.
    """

    patches: Sequence[Colour]
    patch_m: float
    relief: float
    haze: Colour
    verge: Colour = (104, 146, 146)


_PALE: Colour = (222, 214, 204)

PALETTES = {
    "meadow": Palette(
        [(72, 138, 108), (66, 128, 96), (78, 148, 122), (70, 132, 112)], 34, 1.0, _PALE
    ),
    "farmland": Palette(
        [
            (70, 136, 106),
            (110, 176, 186),
            (62, 118, 88),
            (94, 150, 160),
            (80, 158, 130),
            (98, 138, 152),
        ],
        48,
        0.9,
        _PALE,
    ),
    "desert": Palette(
        [(142, 178, 206), (132, 168, 198), (152, 188, 212), (128, 160, 188)],
        42,
        0.8,
        (214, 216, 220),
        (122, 158, 184),
    ),
    "water": Palette([(128, 98, 46), (134, 104, 52), (122, 94, 42)], 60, 0.55, (222, 210, 192)),
}
"""Blue, green, red of each kind of ground."""


def make_ground(
    ground: GroundSettings,
    roads: Sequence[Road],
    shadows: Sequence[Vector],
    area: tuple[float, float, float, float],
    rng: np.random.Generator,
) -> Ground:
    """Generate the ground.

    Args:
        ground: kind of ground.
        roads: to be painted.
        shadows: convex outlines, (N, 2) north and east, of shadows that never move.
        area: south, west, north and east limit of the scene in metres.
        rng: source of randomness.
    """
    palette = PALETTES[ground.kind]
    tint = _tint_map(palette, area, rng, fields=ground.kind == "farmland")
    fine = _fine_map(tint, palette, area, roads, shadows, rng)
    levels = [fine]
    while levels[-1].m_per_px < 0.4 * _FAR_M_PER_PX:
        levels.append(levels[-1].halved())
    far = _far_map(tint, palette, roads, rng)
    coarse = far.halved().halved()
    return Ground(GroundPyramid(levels), GroundPyramid([far, coarse, coarse.halved().halved()]))


def _tint_map(
    palette: Palette,
    area: tuple[float, float, float, float],
    rng: np.random.Generator,
    fields: bool,
) -> GroundMap:
    """Colour patches over the far extent, without small structure."""
    south, west, north, east = area
    size = round(FAR_EXTENT_M / _FAR_M_PER_PX)
    sites = max(8, round((FAR_EXTENT_M / palette.patch_m) ** 2))
    numbers = _nearest_site(rng.uniform(0, size, (sites, 2)), size)
    colours = np.array(palette.patches, np.float64)[rng.integers(len(palette.patches), size=sites)]
    colours *= rng.uniform(0.94, 1.06, (sites, 1))
    image: Image = np.clip(colours, 0, 255).astype(np.uint8)[numbers]
    if not fields:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), palette.patch_m / 4), np.uint8)
    return GroundMap(
        np.asarray(image, np.uint8),
        (north + south) / 2 + FAR_EXTENT_M / 2,
        (west + east) / 2 - FAR_EXTENT_M / 2,
        _FAR_M_PER_PX,
    )


def _nearest_site(sites: Vector, size: int) -> npt.NDArray[np.int32]:
    """Return for each pixel of a square image the number of the nearest site (a Voronoi map)."""
    empty = np.full((size, size), 255, np.uint8)
    at = sites.astype(np.intp)
    empty[at[:, 1], at[:, 0]] = 0
    _, labels = cv2.distanceTransformWithLabels(
        empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    return np.asarray(labels - 1, np.int32) % len(sites)


def _fine_map(
    tint: GroundMap,
    palette: Palette,
    area: tuple[float, float, float, float],
    roads: Sequence[Road],
    shadows: Sequence[Vector],
    rng: np.random.Generator,
) -> GroundMap:
    south, west, north, east = area
    m_per_px = max(0.06, math.sqrt((north - south) * (east - west) / _MOST_PIXELS))
    width, height = round((east - west) / m_per_px), round((north - south) / m_per_px)
    flat = GroundMap(_crop(tint, north, west, m_per_px, (width, height)), north, west, m_per_px)
    layers = [(12.0, 7.0), (3.0, 8.0), (0.8, 11.0), (0.25, 15.0), (0.08, 13.0)]
    cells = [(max(1.0, cell / m_per_px), contrast * palette.relief) for cell, contrast in layers]
    detail = layered_noise(rng, height, width, cells)
    for road in roads:
        paint_road(flat, road)
    cv2.copyTo(cv2.addWeighted(detail, 0.4, detail, 0, 77), road_mask(flat, roads), detail)
    fine = GroundMap(_grained(flat.image, detail), north, west, m_per_px)
    paint_shadows(fine, shadows)
    return fine


def _grained(image: Image, detail: Grey) -> Image:
    """Brighten and darken an image by noise about 128."""
    return np.asarray(cv2.multiply(image, cv2.merge([detail] * 3), scale=1 / 128), np.uint8)


def _crop(
    tint: GroundMap, north: float, west: float, m_per_px: float, size: tuple[int, int]
) -> Image:
    """Enlarge a part of the tint map."""
    scale = m_per_px / tint.m_per_px
    x, y = tint.pixels([(north, west)])[0]
    matrix = np.array([[scale, 0, x + scale / 2 - 0.5], [0, scale, y + scale / 2 - 0.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpAffine(tint.image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(image, np.uint8)


def _far_map(
    tint: GroundMap, palette: Palette, roads: Sequence[Road], rng: np.random.Generator
) -> GroundMap:
    height, width = tint.image.shape[:2]
    cells = [(12.0, 9.0 * palette.relief), (3.0, 9.0 * palette.relief)]
    detail = layered_noise(rng, height, width, cells)
    far = GroundMap(_grained(tint.image, detail), tint.north_m, tint.east_m, tint.m_per_px)
    for road in roads:
        paint_strip(far, road.line, (-road.width_m / 2, road.width_m / 2), road.colour)
    return far
