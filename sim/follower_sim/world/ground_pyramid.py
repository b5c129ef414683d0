"""A piece of ground in several resolutions, all in one image, so that one look finds them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.camera_model import Vector
from follower_vision.images.frame import Image

_EDGE_PX = 1
_TABLE = 256


@dataclass(frozen=True, slots=True)
class GroundMap:
    """A picture of the ground from above, north up.

    Attributes:
        image: BGR.
        north_m: of the top edge.
        east_m: of the left edge.
        m_per_px: size of a pixel on the ground.
    """

    image: Image
    north_m: float
    east_m: float
    m_per_px: float

    def pixels(self, points: npt.ArrayLike) -> Vector:
        """Turn (north, east) points, (N, 2) or (N, 3), into this map's pixels (x, y)."""
        p = np.asarray(points, np.float64)
        return np.column_stack(
            [(p[:, 1] - self.east_m) / self.m_per_px, (self.north_m - p[:, 0]) / self.m_per_px]
        )

    def halved(self) -> GroundMap:
        """Return the map at half the resolution."""
        height, width = self.image.shape[:2]
        small = cv2.resize(self.image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        return GroundMap(np.asarray(small, np.uint8), self.north_m, self.east_m, self.m_per_px * 2)


Plane = npt.NDArray[np.float32]
Levels = npt.NDArray[np.uint8]


class GroundPyramid:
    """Maps of one piece of ground, from fine to coarse, beside each other in one image (a mipmap).

    Attributes:
        image: all maps, BGR and a channel that says nothing: OpenCV looks at four channels in less
            time than at three. Each has an edge about it that repeats its outermost pixels.
        m_per_px: of each map.
        north_m, east_m: of the upper left corner.
        south_m, across_m: how far it reaches from there to the south and to the east.
    """

    def __init__(self, maps: Sequence[GroundMap]) -> None:
        """Put maps together.

        Args:
            maps: from fine to coarse, all with the same upper left corner.
        """
        finest = maps[0]
        self.north_m, self.east_m = finest.north_m, finest.east_m
        self.m_per_px = [one.m_per_px for one in maps]
        # Halving an odd number of pixels leaves some ground out.
        self.south_m = min(one.image.shape[0] * one.m_per_px for one in maps)
        self.across_m = min(one.image.shape[1] * one.m_per_px for one in maps)
        corners = _corners([(one.image.shape[0], one.image.shape[1]) for one in maps])
        whole = _together([one.image for one in maps], corners)
        self.image = np.asarray(cv2.cvtColor(whole, cv2.COLOR_BGR2BGRA), np.uint8)
        self._tables = (
            _table([1 / one.m_per_px for one in maps]),
            _table([column + _EDGE_PX - 0.5 for _, column in corners]),
            _table([row + _EDGE_PX - 0.5 for row, _ in corners]),
        )

    def look(
        self, south: Plane, across: Plane, levels: Levels | int, into: Image | None = None
    ) -> Image:
        """Return the colours of places, (H, W, 3) uint8 BGR.

        Places outside have any colour.

        Args:
            south: (H, W) metres to the south of the upper left corner.
            across: (H, W) metres to the east of it.
            levels: which map to look at, (H, W) or the same for all; 0 is the finest.
            into: an image to put them into, if there is one.
        """
        px_per_m, columns, rows = (_looked_up(table, levels) for table in self._tables)
        x, y = across * px_per_m + columns, south * px_per_m + rows
        seen = cv2.remap(self.image, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        return np.asarray(cv2.cvtColor(seen, cv2.COLOR_BGRA2BGR, into), np.uint8)

    def covers(self, south: Plane, across: Plane) -> Image | None:
        """Return 255 where places lie on the maps, (H, W); None if all do."""
        if _all_within(south, self.south_m) and _all_within(across, self.across_m):
            return None
        rows = cv2.inRange(south, (0,), (self.south_m,))
        return np.asarray(
            cv2.bitwise_and(rows, cv2.inRange(across, (0,), (self.across_m,))), np.uint8
        )

    def mirrored(self, south: Plane, across: Plane) -> tuple[Plane, Plane]:
        """Bring places anywhere to places inside: beyond an edge the ground goes on mirrored."""
        return _folded(south, self.south_m), _folded(across, self.across_m)


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """The ground of a scene.

    Attributes:
        near: where the targets move, in detail.
        far: all around, coarse.
    """

    near: GroundPyramid
    far: GroundPyramid


def _all_within(places: Plane, reach: float) -> bool:
    least, most, _, _ = cv2.minMaxLoc(places)
    return least >= 0 and most <= reach


def _folded(places: Plane, reach: float) -> Plane:
    period = np.float32(2 * reach)
    inside = places - period * np.floor(places / period)
    return np.asarray(np.float32(reach) - np.abs(np.float32(reach) - inside), np.float32)


def _corners(sizes: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the row and column of each map: the finest first, the others along its longer side."""
    height, width = (side + 2 * _EDGE_PX for side in sizes[0])
    corners, along = [(0, 0)], 0
    for size in sizes[1:]:
        corners.append((along, width) if height >= width else (height, along))
        along += size[0 if height >= width else 1] + 2 * _EDGE_PX
    return corners


def _together(images: Sequence[Image], corners: Sequence[tuple[int, int]]) -> Image:
    edge, mode = _EDGE_PX, cv2.BORDER_REPLICATE
    edged = [cv2.copyMakeBorder(one, edge, edge, edge, edge, mode) for one in images]
    places = [
        (slice(row, row + one.shape[0]), slice(column, column + one.shape[1]))
        for (row, column), one in zip(corners, edged, strict=True)
    ]
    size = max(rows.stop for rows, _ in places), max(columns.stop for _, columns in places)
    whole = np.zeros((*size, 3), np.uint8)
    for place, one in zip(places, edged, strict=True):
        whole[place] = one
    return whole


def _looked_up(table: Plane, levels: Levels | int) -> Plane | np.float32:
    if isinstance(levels, int):
        return np.float32(table[levels])
    return np.asarray(cv2.LUT(levels, table), np.float32)


def _table(values: Sequence[float]) -> Plane:
    """Return a table for `cv2.LUT`, which has to have an entry for each byte."""
    table = np.zeros(_TABLE, np.float32)
    table[: len(values)] = values
    return table
