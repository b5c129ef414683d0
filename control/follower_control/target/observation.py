"""One observation of the target: its direction and its angular size."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from follower_control.common.small_matrix import product, transformed
from follower_control.vehicle.gimbal import GimbalHistory, camera_to_world
from follower_control.vehicle.history import AttitudeHistory
from follower_control.vehicle.state import Attitude, GimbalState
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel, CameraView, Vector
from follower_vision.geometry.line_of_sight import CameraMount, LineOfSight, rotation
from follower_vision.trackers.track import Track

BORDER_PX = 1.0
"""A box whose edge comes this near to the image's border counts as cut by it."""
_ENOUGH = 30


class GateVerdict(StrEnum):
    """What became of an observation."""

    STARTED = "started the filter"
    FUSED = "fused"
    GATED = "too far from the prediction"
    RESTARTED = "restarted the filter"
    OUT_OF_ORDER = "not newer than the last sighting"
    NOT_FINITE = "not finite"


class BearingFrame(StrEnum):
    """What a direction is measured against."""

    WORLD = "world"
    """Level; azimuth from north. The vehicle's own turning and tilting are taken out."""
    DOWN = "down"
    """The same turned over, for targets below, where an azimuth from north says nothing: azimuth
    from straight down to the east, elevation from there to the north."""
    BODY = "body"
    """Azimuth from the nose, elevation from the body's plane: all that an image alone says."""


@dataclass(frozen=True, slots=True)
class BearingObservation:
    """The target's direction and angular size at one time.

    Attributes:
        line_of_sight: direction of the box's centre, in `frame`.
        log_scale: natural logarithm of the angular size in radians, which is the square root of
            angular width times angular height. It grows as the target comes nearer: its rate is
            minus the rate of range over range.
        time_s: when the image was taken, on the system's clock.
        frame: what the direction is measured against.
        is_cut: the image's border cuts the box, so that size and centre are doubtful.
    """

    line_of_sight: LineOfSight
    log_scale: float
    time_s: float
    frame: BearingFrame = BearingFrame.WORLD
    is_cut: bool = False

    @property
    def values(self) -> tuple[float, float, float]:
        """(azimuth, elevation, log scale) in radians, radians and 1."""
        return self.line_of_sight.azimuth_rad, self.line_of_sight.elevation_rad, self.log_scale

    @property
    def is_finite(self) -> bool:
        """Whether direction, size and time are all finite."""
        return all(map(math.isfinite, (*self.values, self.time_s)))


def to_line_of_sight(vector: Vector, frame: BearingFrame) -> LineOfSight:
    """Return the direction of a vector (north, east, down) or (forward, right, down)."""
    if frame is BearingFrame.DOWN:
        north, east, down = vector
        vector = np.array([down, east, -north])
    return LineOfSight.from_vector(vector)


def to_vector(direction: LineOfSight, frame: BearingFrame) -> Vector:
    """Return the unit vector, (3,), whose direction this is: the inverse of `to_line_of_sight`."""
    vector = direction.vector
    if frame is not BearingFrame.DOWN:
        return vector
    down, east, south = vector
    return np.array([-south, east, down])


class BearingObserver:
    """Knows one camera: its lens, how it is mounted, and how late its time stamps are.

    Args:
        camera: intrinsics at the size of the images that the boxes belong to.
        mount: how the camera is turned against the body.
        latency_s: how much later than the exposure a frame's time stamp is.

    Attributes:
        looks_down: whether directions are measured from straight down, for targets below.

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

    def observe(
        self, track: Track, attitudes: AttitudeHistory, gimbal: GimbalHistory | None = None
    ) -> BearingObservation | None:
        """Return what a track says about the target, None if nothing can be said.

        With a gimbal it is the gimbal that holds the camera, and the mount does not count.

        With an empty history, as without telemetry, the observation is in the body's frame. With
        telemetry, a frame whose attitude is unknown gives None rather than an observation in
        another frame, on which the filter would have to begin anew.
        """
        time_s = self.exposed_s(track.captured_s)
        attitude = attitudes.at(time_s)
        if attitude is None and len(attitudes) > 0:
            return None
        held = None if gimbal is None else gimbal.at(time_s)
        if gimbal is not None and (held is None or attitude is None):
            return None
        ray, log_scale = self._measure(track.box)
        frame = BearingFrame.DOWN if self.looks_down else BearingFrame.WORLD
        frame = BearingFrame.BODY if attitude is None else frame
        turn = self._camera_to_body if attitude is None else self._camera_to_world(attitude, held)
        direction = to_line_of_sight(transformed(turn, ray), frame)
        is_cut = self._is_cut(track.box)
        seen = BearingObservation(direction, log_scale, time_s, frame, is_cut)
        return seen if seen.is_finite else None

    def view(
        self,
        captured_s: float,
        place_m: Vector,
        attitudes: AttitudeHistory,
        gimbal: GimbalHistory | None = None,
    ) -> CameraView | None:
        """Return how the camera saw an image; None if nobody knows how it was held.

        Args:
            captured_s: the image's time stamp.
            place_m: (3,) north, east, down: where we were.
            attitudes: of the vehicle.
            gimbal: which holds the camera, if one does.
        """
        time_s = self.exposed_s(captured_s)
        attitude = attitudes.at(time_s)
        held = None if gimbal is None else gimbal.at(time_s)
        if attitude is None or (gimbal is not None and held is None):
            return None
        return CameraView(self._camera, self._camera_to_world(attitude, held), place_m)

    def _camera_to_world(self, attitude: Attitude, held: GimbalState | None) -> Vector:
        """Return the 3x3 matrix that turns the camera's vectors into the world's."""
        if held is not None:
            return camera_to_world(held, attitude)
        turn = rotation(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad)
        return product(turn, self._camera_to_body)

    def _measure(self, box: Box) -> tuple[Vector, float]:
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

    def _is_cut(self, box: Box) -> bool:
        return (
            min(box.left, box.top) <= BORDER_PX
            or box.right >= self._camera.width - BORDER_PX
            or box.bottom >= self._camera.height - BORDER_PX
        )


def _angle(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the angle between two unit vectors; exact for small angles, unlike the arc cosine."""
    return 2 * math.asin(min(1.0, math.dist(a, b) / 2))


class SizeMemory:
    """The size that fits a target's ranges by the ground, the mean of its first observations.

    Later ones teach nothing: where the ground rises, the target only seems to grow.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget it."""
        self._log_m: float | None = None
        self._count = 0

    @property
    def log_m(self) -> float | None:
        """Logarithm of the size in metres; None before anything is known."""
        return self._log_m

    def set(self, size_m: float) -> None:
        """Take a size that is known, metres."""
        self._log_m, self._count = math.log(size_m), _ENOUGH

    def assume(self, range_m: float, log_scale: float) -> None:
        """Take a distance, metres, for the true one, until there is better or if there was."""
        if self._log_m is None:
            self._log_m = math.log(range_m) + log_scale

    def learn(self, range_m: float, log_scale: float) -> None:
        """Take in at which distance, metres, it had which log scale."""
        if self._count >= _ENOUGH:
            return
        self._count += 1
        log_m = math.log(range_m) + log_scale
        before = log_m if self._log_m is None or self._count == 1 else self._log_m
        self._log_m = before + (log_m - before) / self._count

    def range_m(self, log_scale: float) -> float:
        """Return the distance at which it has this log scale, metres; infinite without a size."""
        return math.inf if self._log_m is None else math.exp(self._log_m - log_scale)
