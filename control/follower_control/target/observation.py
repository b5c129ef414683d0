"""Turns a box in an image into a sighting, with the attitude at the time of the image."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from follower_control.attitude_history import AttitudeHistory
from follower_control.gimbal import camera_to_world
from follower_control.gimbal_history import GimbalHistory
from follower_control.sighting import SightFrame, Sighting, to_sight
from follower_control.vehicle import Attitude, GimbalState
from follower_vision.box import Box
from follower_vision.camera import CameraModel, Vector
from follower_vision.lineofsight import CameraMount, rotation
from follower_vision.track import Track

BORDER_PX = 1.0
"""A box whose edge comes this near to the image's border counts as cut by it."""

_SEEN_DEPTH, _LEAST_DEPTH = 0.5, 0.2
"""How far ahead of the camera a place is, as a share of its distance: from where on the lens
counts, and what counts at least, for places beside and behind it."""

_AT_US_M = 1e-6


class Sighter:
    """Knows one camera: its lens, how it is mounted, and how late its time stamps are.

    Args:
        camera: intrinsics at the size of the images that the boxes belong to.
        mount: how the camera is turned against the body.
        latency_s: how much later than the exposure a frame's time stamp is.

    Attributes:
        looks_down: whether sightings are told from straight down, for targets below.

    Raises:
        ValueError: the latency is not finite.
    """

    def __init__(self, camera: CameraModel, mount: CameraMount, latency_s: float = 0.0) -> None:
        if not math.isfinite(latency_s):
            raise ValueError(f"a camera's latency is a finite number of seconds, not {latency_s}")
        self._camera = camera
        self._camera_to_body = mount.camera_to_body
        self._latency_s = latency_s
        self.looks_down = False

    def exposed_s(self, captured_s: float) -> float:
        """Return when a frame with this time stamp was exposed."""
        return captured_s - self._latency_s

    def sight(
        self, track: Track, attitudes: AttitudeHistory, gimbal: GimbalHistory | None = None
    ) -> Sighting | None:
        """Return what a track says about the target, None if nothing can be said.

        With a gimbal it is the gimbal that holds the camera, and the mount does not count.

        With an empty history, as without telemetry, the sighting is in the body's frame. With
        telemetry, a frame whose attitude is unknown gives None rather than a sighting in another
        frame, on which the filter would have to begin anew.
        """
        time_s = self.exposed_s(track.captured_s)
        attitude = attitudes.at(time_s)
        if attitude is None and len(attitudes) > 0:
            return None
        held = None if gimbal is None else gimbal.at(time_s)
        if gimbal is not None and (held is None or attitude is None):
            return None
        ray, log_scale = self._look(track.box)
        frame = SightFrame.DOWN if self.looks_down else SightFrame.WORLD
        frame = SightFrame.BODY if attitude is None else frame
        sight = to_sight(self._turned(ray, attitude, held), frame)
        sighting = Sighting(sight, log_scale, time_s, frame, self._cuts(track.box))
        return sighting if sighting.is_finite else None

    def image_of(
        self,
        away_m: Vector,
        captured_s: float,
        attitudes: AttitudeHistory,
        gimbal: GimbalHistory | None = None,
    ) -> Vector | None:
        """Return where places are in an image, (N, 2) pixels; None if nobody knows how it was held.

        What is far beside the image or behind the camera is put so far beside it as the lens'
        straight lines would have it, on the right side.

        Args:
            away_m: (N, 3) north, east, down from us.
            captured_s: the image's time stamp.
            attitudes: of the vehicle.
            gimbal: which holds the camera, if one does.
        """
        time_s = self.exposed_s(captured_s)
        attitude = attitudes.at(time_s)
        held = None if gimbal is None else gimbal.at(time_s)
        if attitude is None or (gimbal is not None and held is None):
            return None
        points = away_m @ self._turned(np.eye(3), attitude, held)
        distances = np.maximum(np.sqrt(np.einsum("ij,ij->i", points, points)), _AT_US_M)
        depth = np.maximum(points[:, 2], _LEAST_DEPTH * distances)
        pixels = np.empty((len(points), 2))
        pixels[:, 0] = self._camera.cx + self._camera.fx * points[:, 0] / depth
        pixels[:, 1] = self._camera.cy + self._camera.fy * points[:, 1] / depth
        seen = points[:, 2] > _SEEN_DEPTH * distances
        pixels[seen] = self._camera.pixels(points[seen])
        return pixels

    def _turned(
        self, vectors: Vector, attitude: Attitude | None, held: GimbalState | None
    ) -> Vector:
        """Turn the camera's vectors, (3,) or (3, N), into the world's, or the body's."""
        if held is not None and attitude is not None:
            return np.asarray(camera_to_world(held, attitude) @ vectors)
        body = self._camera_to_body @ vectors
        if attitude is None:
            return np.asarray(body)
        turn = rotation(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
        return np.asarray(turn @ body)

    def _look(self, box: Box) -> tuple[Vector, float]:
        """Return the centre's ray in the camera frame and the logarithm of the angular size."""
        pixels = [
            (box.cx, box.cy),
            (box.left, box.cy),
            (box.right, box.cy),
            (box.cx, box.top),
            (box.cx, box.bottom),
        ]
        rays = self._camera.rays(pixels)
        _, left, right, top, bottom = rays.tolist()
        area = _angle(left, right) * _angle(top, bottom)
        return rays[0], 0.5 * math.log(area) if area > 0 else math.nan

    def _cuts(self, box: Box) -> bool:
        return (
            min(box.left, box.top) <= BORDER_PX
            or box.right >= self._camera.width - BORDER_PX
            or box.bottom >= self._camera.height - BORDER_PX
        )


def _angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the angle between two unit vectors; exact for small angles, unlike the arc cosine."""
    return 2 * math.asin(min(1.0, math.dist(a, b) / 2))
