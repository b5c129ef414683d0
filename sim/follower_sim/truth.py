"""The truth about what the camera sees: for the score alone, never for the vision side."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.kinematics import BodyState, Triple
from follower_sim.lens import NEAR_M, Lens
from follower_sim.noise import Grey
from follower_sim.painter import FixedPoints, SolidBatch, SolidPainter
from follower_sim.solid import Solid
from follower_sim.truth_sample import TruthSample
from follower_sim.view import View
from follower_sim.world import World
from follower_vision.box import Box
from follower_vision.camera import CameraModel, Vector
from follower_vision.lineofsight import CameraMount, LineOfSight, wrap_angle

_MASK_PX = 64
_SHIFT = 4


@dataclass(frozen=True, slots=True)
class TargetTruth:
    """Where the followed target really is.

    Attributes:
        time_s: of the scenario.
        box: tight box of its projected corners, beyond the image's edges too; None if it is
            behind the camera, far outside the view, or not in the world.
        in_frame_share: share of that box inside the image.
        visible_share: share of its silhouette that nothing nearer hides.
        position_m: (north, east, down) of its centre.
        velocity_m_s: (north, east, down).
        range_m: from the camera to its centre.
        line_of_sight: from the vehicle, azimuth from the vehicle's heading, elevation from the
            horizontal.
    """

    time_s: float
    box: Box | None
    in_frame_share: float
    visible_share: float
    position_m: Triple
    velocity_m_s: Triple
    range_m: float
    line_of_sight: LineOfSight


class TruthTeller:
    """Computes the truth for one world and camera; keeps what does not change.

    Args:
        world: what there is.
        camera: intrinsics and distortion; the scenario's own if None.
        mount: how the camera is turned against the body; the scenario's own if None.
    """

    def __init__(
        self, world: World, camera: CameraModel | None = None, mount: CameraMount | None = None
    ) -> None:
        self._world = world
        self._camera = camera or world.scenario.camera.model
        self._mount = mount or world.scenario.camera.mount
        self._lens = Lens(self._camera)
        self._painter = SolidPainter(self._lens)
        self._centres = np.array([body.centre for body in world.scenery]).reshape(-1, 3)
        self._radii = np.array([body.radius_m for body in world.scenery])

    def truth(self, time_s: float, body: BodyState, camera: BodyState | None = None) -> TargetTruth:
        """Return the truth at a time of the scenario, with the vehicle at `body`.

        `camera` is the body that carries the camera, if that is not the vehicle's: a gimbal.
        """
        number = self._world.scenario.followed
        centre = np.array(self._world.target_centre(number, time_s))
        away = centre - np.array(body.position_m)
        sight = LineOfSight.from_vector(away)
        azimuth = wrap_angle(sight.azimuth_rad - body.yaw_rad)
        box, in_frame, visible = self._in_image(
            number, time_s, View.of(camera or body, self._mount)
        )
        pose = self._world.target_pose(number, time_s)
        return TargetTruth(
            time_s,
            box,
            in_frame,
            visible,
            (float(centre[0]), float(centre[1]), float(centre[2])),
            pose.velocity_m_s,
            float(np.linalg.norm(away)),
            LineOfSight(azimuth, sight.elevation_rad),
        )

    def sample(
        self,
        time_s: float,
        body: BodyState,
        clock_s: float | None = None,
        camera: BodyState | None = None,
    ) -> TruthSample:
        """Return the truth as the score wants it, stamped `clock_s` (else `time_s`)."""
        truth = self.truth(time_s, body, camera)
        return TruthSample(
            time_s if clock_s is None else clock_s,
            body,
            truth.position_m,
            truth.velocity_m_s,
            truth.in_frame_share,
            truth.visible_share,
            truth.range_m,
            truth.line_of_sight.azimuth_rad,
            truth.line_of_sight.elevation_rad,
        )

    def _in_image(self, number: int, time_s: float, view: View) -> tuple[Box | None, float, float]:
        """Return the box, its share in the frame, and the share that nothing hides."""
        if not self._world.is_present(number, time_s):
            return None, 0.0, 0.0
        solid = self._world.target_solid(number, time_s)
        box = self._box(solid, view)
        if box is None:
            return None, 0.0, 0.0
        in_frame = min(1.0, box.visible_share(self._camera.width, self._camera.height))
        return box, in_frame, self._visible_share(number, time_s, solid, box, view)

    def _box(self, solid: Solid, view: View) -> Box | None:
        corners = view.to_camera(solid.vertices)
        if not (corners[:, 2] > NEAR_M).any() or self._lens.outside(corners).all(axis=0).any():
            return None
        corners = corners[~self._lens.outside(corners).any(axis=1)]
        if not len(corners):
            return None
        pixels = self._lens.pixels(corners)
        (left, top), (right, bottom) = pixels.min(axis=0), pixels.max(axis=0)
        if right - left < 1e-6 or bottom - top < 1e-6:
            return None
        return Box.from_xywh(float(left), float(top), float(right - left), float(bottom - top))

    def _visible_share(
        self, number: int, time_s: float, solid: Solid, box: Box, view: View
    ) -> float:
        """Draw the target's silhouette, paint over it what is nearer, and count."""
        nearer = self._nearer(number, time_s, solid, view)
        if not nearer:
            return 1.0
        own = self._drawn(np.zeros((_MASK_PX, _MASK_PX), np.uint8), [solid], box, view, 255)
        before = cv2.countNonZero(own)
        left = self._drawn(own, nearer, box, view, 0)
        return cv2.countNonZero(left) / before if before else 1.0

    def _nearer(self, number: int, time_s: float, solid: Solid, view: View) -> list[Solid]:
        """Return the bodies whose spheres touch the line of sight in front of the target."""
        others = [
            self._world.target_solid(n, time_s)
            for n in range(len(self._world.paths))
            if n != number and self._world.is_present(n, time_s)
        ]
        bodies = [*self._world.scenery, *others]
        if not bodies:
            return []
        centres = np.vstack([self._centres, *(body.centre for body in others)]) - view.position_m
        radii = np.append(self._radii, [body.radius_m for body in others])
        hit = _in_front(centres, radii, solid.centre - view.position_m, solid.radius_m)
        return [bodies[i] for i in np.flatnonzero(hit)]

    def _drawn(self, mask: Grey, solids: list[Solid], box: Box, view: View, value: int) -> Grey:
        selection = self._painter.select([SolidBatch.of(solids)], view)
        for _, polygon in self._painter.polygons(selection.corners, view):
            cv2.fillConvexPoly(mask, _into(polygon, box), (value,), cv2.LINE_8, _SHIFT)
        return mask


def _in_front(
    centres: Vector, radii: Vector, target: Vector, target_radius: float
) -> npt.NDArray[np.bool_]:
    """Return which spheres about points, (N, 3) seen from the camera, can hide the target."""
    distance = float(np.linalg.norm(target))
    along = centres @ target / distance
    beside2 = (centres**2).sum(axis=1) - along**2
    nearer = np.linalg.norm(centres, axis=1) < distance
    touching = beside2 < (radii + target_radius) ** 2
    return np.asarray(nearer & touching & (along > -radii))


def _into(polygon: FixedPoints, box: Box) -> FixedPoints:
    """Stretch image polygons so that the box fills the mask."""
    corner = np.array([box.left, box.top]) - 0.5
    scale = np.array([_MASK_PX / box.width, _MASK_PX / box.height])
    pixels = (polygon / (1 << _SHIFT) - corner) * scale - 0.5
    return np.asarray(np.clip(np.round(pixels * (1 << _SHIFT)), -1e6, 1e6), np.int32)


def target_truth(
    world: World,
    time_s: float,
    body: BodyState,
    camera: CameraModel | None = None,
    mount: CameraMount | None = None,
) -> TargetTruth:
    """Return the truth once; keep a `TruthTeller` where it is asked for often."""
    return TruthTeller(world, camera, mount).truth(time_s, body)
