"""Where a body lies in an image, and how much of it nothing nearer hides."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from follower_control.common.small_matrix import length
from follower_sim.kinematics import Triple
from follower_sim.view import CameraView
from follower_sim.world.noise import Grey
from follower_sim.world.painter import FixedPoints, LensProjection, SolidBatch, SolidPainter
from follower_sim.world.solid import Solid
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel, Vector

_SPARE_M = 4.0
"""So far the camera or the target may move before all bodies are looked through again."""
_MASK_PX = 64
_SHIFT = 4


@dataclass(frozen=True, slots=True)
class BoundingSphere:
    """A ball in the world: its middle (north, east, down) and its radius."""

    centre_m: Triple
    radius_m: float


Standing = tuple[BoundingSphere, Solid]


class Corridor:
    """Finds the bodies about a line of sight, which are few, without a look at all of them."""

    def __init__(self, standing: Sequence[Solid]) -> None:
        self._standing: list[Standing] = [(ball_of(solid), solid) for solid in standing]
        self._centres = np.array([ball.centre_m for ball, _ in self._standing]).reshape(-1, 3)
        self._radii = np.array([ball.radius_m for ball, _ in self._standing])
        self._ends: tuple[Triple, Triple] | None = None
        self._radius_m = -math.inf
        self._about: list[Standing] = []

    def about(self, eye_m: Triple, target: BoundingSphere) -> list[Standing]:
        """Return, in their order, all bodies that can hide any of a ball, and few others."""
        if not self._still_holds(eye_m, target):
            self._ends, self._radius_m = (eye_m, target.centre_m), target.radius_m
            # What hides has its middle no farther from the line than both radii, or the eye in it.
            near = self._distances_m(eye_m, target) < 2 * self._radii + target.radius_m + _SPARE_M
            self._about = [self._standing[i] for i in np.flatnonzero(near)]
        return self._about

    def _still_holds(self, eye_m: Triple, target: BoundingSphere) -> bool:
        if self._ends is None or target.radius_m > self._radius_m:
            return False
        eye, end = self._ends
        return math.dist(eye, eye_m) < _SPARE_M and math.dist(end, target.centre_m) < _SPARE_M

    def _distances_m(self, eye_m: Triple, target: BoundingSphere) -> Vector:
        """Return how far each body's middle, (N,), is from the line between eye and target."""
        line = np.subtract(target.centre_m, eye_m)
        away = self._centres - eye_m
        along = np.clip((away * line).sum(axis=1) / max(length(line) ** 2, 1e-9), 0.0, 1.0)
        return np.asarray(np.linalg.norm(away - along[:, None] * line, axis=1))


def ball_of(solid: Solid) -> BoundingSphere:
    """Return the ball that holds a body."""
    north, east, down = solid.centre.tolist()
    return BoundingSphere((north, east, down), solid.radius_m)


def hides(one: BoundingSphere, target: BoundingSphere, eye_m: Triple) -> bool:
    """Whether what one ball holds can hide any of what another one holds."""
    # Plain floats are fastest for so few.
    north, east, down = (a - b for a, b in zip(one.centre_m, eye_m, strict=True))
    to_north, to_east, to_down = (a - b for a, b in zip(target.centre_m, eye_m, strict=True))
    away2 = north * north + east * east + down * down
    range2 = to_north * to_north + to_east * to_east + to_down * to_down
    if away2 >= range2:
        return False
    along = (north * to_north + east * to_east + down * to_down) / math.sqrt(range2)
    near = away2 - along * along < (one.radius_m + target.radius_m) ** 2
    return near and along > -one.radius_m


@dataclass(frozen=True, slots=True)
class SeenBody:
    """A body in an image.

    Attributes:
        box: tight box of its projected corners, beyond the image's edges too; None if it is
            behind the camera or far outside the view.
        in_frame_share: share of that box inside the image.
        visible_share: share of its silhouette that nothing nearer hides.
    """

    box: Box | None
    in_frame_share: float
    visible_share: float


UNSEEN = SeenBody(None, 0.0, 0.0)


class Silhouettes:
    """Finds bodies in the images of one camera.

    Args:
        camera: intrinsics and distortion.
        standing: what never moves and may hide a body.
    """

    def __init__(self, camera: CameraModel, standing: Sequence[Solid]) -> None:
        self._camera = camera
        self._lens = LensProjection(camera)
        self._painter = SolidPainter(self._lens)
        self._corridor = Corridor(standing)

    def seen(self, solid: Solid, moving: Sequence[Solid], view: CameraView) -> SeenBody:
        """Return where a body is, among others that move."""
        box = self.box(solid.vertices, view)
        if box is None:
            return UNSEEN
        return SeenBody(box, self.in_frame_share(box), self.visible_share(solid, moving, box, view))

    def is_wholly_in_frame(self, ball: BoundingSphere, view: CameraView) -> bool:
        """Whether a ball surely lies in the image with all that it holds."""
        return self._lens.holds(view.to_camera(ball.centre_m)[0], ball.radius_m)

    def is_in_the_open(
        self, ball: BoundingSphere, others: Sequence[BoundingSphere], view: CameraView
    ) -> bool:
        """Whether nothing, standing or among others that move, can hide what a ball holds."""
        standing = [one for one, _ in self._corridor.about(view.eye_m, ball)]
        return not any(hides(one, ball, view.eye_m) for one in (*standing, *others))

    def in_frame_share(self, box: Box) -> float:
        """Return the share of a box that lies inside the image."""
        return min(1.0, box.visible_share(self._camera.width, self._camera.height))

    def box(self, vertices: Vector, view: CameraView) -> Box | None:
        """Return the tight box of a body's corners, (V, 3), None if it is not in view."""
        corners = view.to_camera(vertices)
        outside = self._lens.outside(corners)
        if outside.any():
            if outside.all(axis=0).any():
                return None
            corners = corners[~outside.any(axis=1)]
            if not len(corners):
                return None
        return self._about(corners)

    def whole_box(self, vertices: Vector, view: CameraView) -> Box | None:
        """Return the tight box of the corners, (V, 3), of a body that is wholly in the image."""
        return self._about(view.to_camera(vertices))

    def _about(self, corners: Vector) -> Box | None:
        """Return the tight box of corners in camera axes, (V, 3), all of which have an image."""
        x, y = self._lens.pixels(corners).T.copy()
        left, top, right, bottom = (float(end) for end in (x.min(), y.min(), x.max(), y.max()))
        if right - left < 1e-6 or bottom - top < 1e-6:
            return None
        return Box.from_xywh(left, top, right - left, bottom - top)

    def visible_share(
        self, solid: Solid, moving: Sequence[Solid], box: Box, view: CameraView
    ) -> float:
        """Draw the silhouette in its box, paint over it what is nearer, and count."""
        nearer = self._nearer(solid, moving, view)
        if not nearer:
            return 1.0
        hiding = self._polygons(nearer, box, view)
        if not hiding:
            return 1.0
        mask = np.zeros((_MASK_PX, _MASK_PX), np.uint8)
        _fill(mask, self._polygons([solid], box, view), 255)
        before = cv2.countNonZero(mask)
        _fill(mask, hiding, 0)
        return cv2.countNonZero(mask) / before if before else 1.0

    def _nearer(self, solid: Solid, moving: Sequence[Solid], view: CameraView) -> list[Solid]:
        """Return the bodies whose spheres touch the line of sight in front of the body."""
        target = ball_of(solid)
        bodies = [*self._corridor.about(view.eye_m, target), *((ball_of(b), b) for b in moving)]
        return [body for ball, body in bodies if hides(ball, target, view.eye_m)]

    def _polygons(self, solids: list[Solid], box: Box, view: CameraView) -> list[FixedPoints]:
        """Return the polygons of bodies that reach into the mask, which the box fills."""
        selection = self._painter.select([SolidBatch.of(solids)], view)
        polygons = [polygon for _, polygon in self._painter.polygons(selection.corners, view)]
        if not polygons:
            return []
        points = _into(np.concatenate(polygons), box)
        ends = np.cumsum([len(polygon) for polygon in polygons])
        starts = np.concatenate([[0], ends[:-1]])
        high = np.maximum.reduceat(points, starts, axis=0) >= -(1 << _SHIFT)
        low = np.minimum.reduceat(points, starts, axis=0) <= (_MASK_PX + 1) << _SHIFT
        reaching = np.flatnonzero(np.all(high & low, axis=1))
        return [points[starts[i] : ends[i]] for i in reaching.tolist()]


def _fill(mask: Grey, polygons: list[FixedPoints], value: int) -> None:
    for polygon in polygons:
        cv2.fillConvexPoly(mask, polygon, (value,), cv2.LINE_8, _SHIFT)


def _into(polygon: FixedPoints, box: Box) -> FixedPoints:
    """Stretch image polygons so that the box fills the mask."""
    corner = np.array([box.left, box.top]) - 0.5
    scale = np.array([_MASK_PX / box.width, _MASK_PX / box.height])
    pixels = (polygon / (1 << _SHIFT) - corner) * scale - 0.5
    return np.asarray(np.clip(np.round(pixels * (1 << _SHIFT)), -1e6, 1e6), np.int32)
