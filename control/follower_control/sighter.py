"""Turns a box in an image into a sighting, with the attitude at the time of the image."""

from __future__ import annotations

import math
from collections.abc import Sequence

from follower_control.attitude_history import AttitudeHistory
from follower_control.gimbal import camera_to_world
from follower_control.gimbal_history import GimbalHistory
from follower_control.sighting import SightFrame, Sighting, to_sight
from follower_control.vehicle import Attitude
from follower_vision.box import Box
from follower_vision.camera import CameraModel, Vector
from follower_vision.lineofsight import CameraMount, rotation
from follower_vision.track import Track

BORDER_PX = 1.0
"""A box whose edge comes this near to the image's border counts as cut by it."""


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

    def sight(
        self, track: Track, attitudes: AttitudeHistory, gimbal: GimbalHistory | None = None
    ) -> Sighting | None:
        """Return what a track says about the target, None if nothing can be said.

        With a gimbal it is the gimbal that holds the camera, and the mount does not count.

        With an empty history, as without telemetry, the sighting is in the body's frame. With
        telemetry, a frame whose attitude is unknown gives None rather than a sighting in another
        frame, on which the filter would have to begin anew.
        """
        time_s = track.captured_s - self._latency_s
        attitude = attitudes.at(time_s)
        if attitude is None and len(attitudes) > 0:
            return None
        held = None if gimbal is None else gimbal.at(time_s)
        if gimbal is not None and (held is None or attitude is None):
            return None
        ray, log_scale = self._look(track.box)
        frame = SightFrame.DOWN if self.looks_down else SightFrame.WORLD
        frame = SightFrame.BODY if attitude is None else frame
        if held is not None and attitude is not None:
            vector = camera_to_world(held, attitude) @ ray
        else:
            vector = _body_to_frame(attitude, self._camera_to_body @ ray)
        sight = to_sight(vector, frame)
        sighting = Sighting(sight, log_scale, time_s, frame, self._cuts(track.box))
        return sighting if sighting.is_finite else None

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


def _body_to_frame(attitude: Attitude | None, vector: Vector) -> Vector:
    if attitude is None:
        return vector
    turn = rotation(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
    return turn @ vector


def _angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the angle between two unit vectors; exact for small angles, unlike the arc cosine."""
    return 2 * math.asin(min(1.0, math.dist(a, b) / 2))
