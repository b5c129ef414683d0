"""The truth about what the camera sees: for the score alone, never for the vision side."""

import math
from collections.abc import Sequence
from dataclasses import replace

from follower_control.common.small_matrix import transformed
from follower_sim.kinematics import BodyState, TruthSample
from follower_sim.view import CameraView
from follower_sim.world.silhouettes import UNSEEN, SeenBody, Silhouettes
from follower_sim.world.solid import Solid
from follower_sim.world.world import World
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import LineOfSight, wrap_angle

_TURNED = CameraModel.from_fov(640, 480, math.radians(75))
"""A camera that is turned to what the real one does not see."""


class GroundTruth:
    """Computes the truth for one world and its camera; keeps what does not change.

    Args:
        world: what there is; its scenario has the camera and how it is mounted.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._mount = world.scenario.camera.mount
        self._camera = world.scenario.camera.model
        self._silhouettes = Silhouettes(self._camera, world.scenery)
        self._turned = Silhouettes(_TURNED, world.scenery)

    def seen(self, time_s: float, camera: BodyState) -> SeenBody:
        """Return where the target is in the image; `camera` is the body that carries it."""
        number = self._world.scenario.followed
        return self._seen(number, time_s, CameraView.of(camera, self._mount))

    def sample(
        self, time_s: float, body: BodyState, camera: BodyState | None = None
    ) -> TruthSample:
        """Return the truth as the score needs it.

        Args:
            time_s: of the scenario.
            body: the vehicle.
            camera: the body that carries the camera, if that is not the vehicle's: a gimbal.
        """
        world, number = self._world, self._world.scenario.followed
        in_frame, visible = self._shares(time_s, CameraView.of(camera or body, self._mount))
        centre = world.target_centre(number, time_s)
        north, east, down = (c - p for c, p in zip(centre, body.position_m, strict=True))
        sight = LineOfSight.towards(north, east, down)
        return TruthSample(
            time_s,
            body,
            centre,
            world.target_pose(number, time_s).velocity_m_s,
            in_frame,
            visible,
            math.sqrt(north * north + east * east + down * down),
            wrap_angle(sight.azimuth_rad - body.yaw_rad),
            sight.elevation_rad,
        )

    def box_sight(self, sample: TruthSample, camera: BodyState | None = None) -> LineOfSight:
        """Return the direction of the true box's middle, which is what a tracker can show.

        Of a body that is seen from above it is not quite that of the body's middle. Without a box,
        the answer is that. Azimuth from the vehicle's heading, elevation from the horizontal.

        Args:
            sample: the truth at one instant.
            camera: the body that carries the camera then, if that is not the vehicle's.
        """
        body = sample.vehicle
        box = self.seen(sample.time_s, camera or body).box
        if box is None:
            return LineOfSight(sample.azimuth_rad, sample.elevation_rad)
        (ray,) = self._camera.rays([[box.cx, box.cy]])
        world_to_camera = CameraView.of(camera or body, self._mount).world_to_camera
        sight = LineOfSight.from_vector(transformed(world_to_camera.T, ray))
        return LineOfSight(wrap_angle(sight.azimuth_rad - body.yaw_rad), sight.elevation_rad)

    def others(self, time_s: float, body: BodyState, camera: BodyState | None = None) -> list[Box]:
        """Return the boxes of the targets that are not followed, where something of them shows.

        Args:
            time_s: of the scenario.
            body: the vehicle.
            camera: the body that carries the camera, if that is not the vehicle's.
        """
        followed, view = self._world.scenario.followed, CameraView.of(camera or body, self._mount)
        numbers = [n for n in range(len(self._world.paths)) if n != followed]
        seen = [self._seen(number, time_s, view) for number in numbers]
        return [one.box for one in seen if one.box is not None and one.visible_share > 0]

    def _shares(self, time_s: float, view: CameraView) -> tuple[float, float]:
        """Return how much of the target's box is in the image, and how much nothing hides."""
        world, number = self._world, self._world.scenario.followed
        if world.is_present(number, time_s):
            ball = world.target_ball(number, time_s)
            wholly = self._silhouettes.is_wholly_in_frame(ball, view)
            if wholly and self._is_in_the_open(number, time_s, view):
                return 1.0, 1.0
        seen = self._seen(number, time_s, view)
        return seen.in_frame_share, seen.visible_share

    def _seen(self, number: int, time_s: float, view: CameraView) -> SeenBody:
        """Return where a target is in the image; nowhere if it is not in the world."""
        world = self._world
        if not world.is_present(number, time_s):
            return UNSEEN
        if not self._is_in_the_open(number, time_s, view):
            return self._seen_among_others(number, time_s, view)
        ball, corners = world.target_ball(number, time_s), world.target_corners(number, time_s)
        wholly = self._silhouettes.is_wholly_in_frame(ball, view)
        box_of = self._silhouettes.whole_box if wholly else self._silhouettes.box
        box = box_of(corners, view)
        in_frame = 0.0 if box is None else self._silhouettes.in_frame_share(box)
        return SeenBody(box, in_frame, 1.0)

    def _is_in_the_open(self, number: int, time_s: float, view: CameraView) -> bool:
        """Whether surely nothing hides any of a target; asked before anything is drawn."""
        world = self._world
        others = [world.target_ball(n, time_s) for n in self._others(number, time_s)]
        return self._silhouettes.is_in_the_open(world.target_ball(number, time_s), others, view)

    def _others(self, number: int, time_s: float) -> list[int]:
        """Return the numbers of the other targets that are there."""
        numbers = range(len(self._world.paths))
        return [n for n in numbers if n != number and self._world.is_present(n, time_s)]

    def _seen_among_others(self, number: int, time_s: float, view: CameraView) -> SeenBody:
        """Draw a target, and what may hide it."""
        world = self._world
        others = [world.target_solid(n, time_s, lit=False) for n in self._others(number, time_s)]
        solid = world.target_solid(number, time_s, lit=False)
        seen = self._silhouettes.seen(solid, others, view)
        return seen if seen.box is not None else self._out_of_view(solid, others, view)

    def _out_of_view(self, solid: Solid, others: Sequence[Solid], view: CameraView) -> SeenBody:
        """Return a body without a box, with whether something hides it: unseen is not hidden."""
        towards = CameraView.towards(view.position_m, solid.centre)
        share = self._turned.seen(solid, others, towards).visible_share
        return replace(UNSEEN, visible_share=share)
