"""The ground's colours as maps, generated once from a seed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.bodies.mesh import Colour
from follower_sim.scenario.scenario import GroundSettings
from follower_sim.world.ground_pyramid import Ground, GroundMap, GroundPyramid
from follower_sim.world.noise import Grey, layered_noise
from follower_vision.geometry.camera_model import Vector
from follower_vision.images.frame import Image

_ASPHALT: Colour = (112, 108, 106)
_DIRT: Colour = (122, 154, 178)
_PAINT: Colour = (226, 232, 234)
_DASH_M, _GAP_M = 3.0, 5.0
_PIECE = 40
_SHADE = 150
_SHIFT = 4

FAR_EXTENT_M = 2400.0
_FAR_M_PER_PX = 1.0
_MOST_PIXELS, _LONGEST_PX = 18e6, 32_000
"""Of the map in detail: what memory may hold, and what `cv2.remap` takes along a side."""
_PALE: Colour = (222, 214, 204)


@dataclass(frozen=True, slots=True)
class Road:
    """A road to be painted.

    Attributes:
        line: (N, 3) points of its middle in the world.
        width_m: from edge to edge.
        paved: asphalt with markings, else a dirt track.
        verge: colour of its edges, and of the middle of a dirt track.
    """

    line: Vector
    width_m: float
    paved: bool
    verge: Colour

    @property
    def colour(self) -> Colour:
        """Colour of its surface."""
        return _ASPHALT if self.paved else _DIRT


def paint_road(ground: GroundMap, road: Road) -> None:
    """Paint verge, surface and, on asphalt, markings."""
    half = road.width_m / 2
    paint_strip(ground, road.line, (-half - 0.9, half + 0.9), road.verge)
    paint_strip(ground, road.line, (-half, half), road.colour)
    if not road.paved:
        paint_strip(ground, road.line, (-0.5, 0.5), road.verge)
        return
    for edge in (0.3 - half, half - 0.42):
        paint_strip(ground, road.line, (edge, edge + 0.12), _PAINT)
    for dash in _dashes(road.line):
        paint_strip(ground, dash, (-0.06, 0.06), _PAINT)


def _dashes(line: Vector) -> list[Vector]:
    """Cut a line into the dashes of its middle marking."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    starts = np.arange(0.0, lengths[-1], _DASH_M + _GAP_M)
    pieces = [line[(lengths >= s) & (lengths <= s + _DASH_M)] for s in starts]
    return [piece for piece in pieces if len(piece) > 1]


def paint_strip(
    ground: GroundMap, line: Vector, span: tuple[float, float], colour: Colour | int
) -> None:
    """Fill the strip between two offsets (metres, right is positive) from a line."""
    tangent = np.gradient(line[:, :2], axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    right = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    edges = [ground.pixels(line[:, :2] + right * offset) for offset in span]
    for i in range(0, len(line) - 1, _PIECE):
        piece = slice(i, i + _PIECE + 2)
        outline = np.vstack([edges[0][piece], edges[1][piece][::-1]])
        cv2.fillPoly(ground.image, [_fixed(outline)], _colour(colour), cv2.LINE_AA, _SHIFT)


def _colour(colour: Colour | int) -> tuple[float, ...]:
    return (colour,) if isinstance(colour, int) else colour


def _fixed(points: Vector) -> npt.NDArray[np.int32]:
    """Turn pixels from the corner into OpenCV's fixed-point pixels from the first centre."""
    return np.asarray(np.round((points - 0.5) * (1 << _SHIFT)), np.int32)


def road_mask(ground: GroundMap, roads: Sequence[Road]) -> Grey:
    """Return a mask, 255 where the ground is road."""
    shape = ground.image.shape[:2]
    mask = GroundMap(np.zeros(shape, np.uint8), ground.north_m, ground.east_m, ground.m_per_px)
    for road in roads:
        paint_strip(mask, road.line, (-road.width_m / 2, road.width_m / 2), 255)
    return mask.image


def paint_shadows(ground: GroundMap, outlines: Sequence[Vector]) -> None:
    """Darken the ground within convex outlines, (N, 2) north and east, with soft edges."""
    shape = ground.image.shape[:2]
    light = np.full(shape, 255, np.uint8)
    for outline in outlines:
        cv2.fillConvexPoly(light, _fixed(ground.pixels(outline)), _SHADE, cv2.LINE_AA, _SHIFT)
    soft = cv2.blur(light, (5, 5))
    cv2.multiply(ground.image, cv2.merge([soft] * 3), dst=ground.image, scale=1 / 255)


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
    tall_m, wide_m = north - south, east - west
    m_per_px = max(
        0.06, math.sqrt(tall_m * wide_m / _MOST_PIXELS), max(tall_m, wide_m) / _LONGEST_PX
    )
    width, height = round(wide_m / m_per_px), round(tall_m / m_per_px)
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
