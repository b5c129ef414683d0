"""Roads and standing shadows, painted onto a map of the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.ground_map import GroundMap
from follower_sim.mesh import Colour
from follower_sim.noise import Grey
from follower_vision.camera import Vector

_ASPHALT: Colour = (112, 108, 106)
_DIRT: Colour = (122, 154, 178)
_PAINT: Colour = (226, 232, 234)
_DASH_M, _GAP_M = 3.0, 5.0
_PIECE = 40
_SHADE = 150
_SHIFT = 4


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
