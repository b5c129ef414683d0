"""Whether the image moves as the vehicle's attitude says it must, when it is turned by hand.

A target that stands still moves in the image because the camera turns. How the camera turns, the
autopilot's attitude and the mount's angles say; from that follows where in the image the target
has to be next. The two-by-two matrix A that takes the motion expected into the motion seen, fitted
by least squares, is the identity for a camera that is mounted as described. Of a mirrored one it
is diag(-1, 1), of one upside down -1, of one on its side a quarter turn.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from follower.settings.settings import Settings
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import FollowMode, ServoSettings
from follower_control.target.estimator import TargetEstimator
from follower_control.target.observation import BearingObserver
from follower_control.vehicle.history import AttitudeHistory
from follower_control.vehicle.setpoint import VelocitySetpoint
from follower_control.vehicle.state import Attitude, VehicleState
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.geometry.line_of_sight import CameraMount, LineOfSight, rotation, wrap_angle
from follower_vision.trackers.track import Track, TrackState

_LEAST_INTERVAL_S, _LONGEST_INTERVAL_S = 0.15, 0.6
_FORGET = 0.99
_ENOUGH_RAD = math.radians(40)
_PLENTY_RAD = math.radians(90)
_LITTLE_RAD = math.radians(15)
_RIDGE = math.radians(1) ** 2
_CLEAR, _SMALL = 0.5, 0.5
_CLEAR_PER_S = 0.3
_LEAST_GAIN, _MOST_GAIN = 0.75, 1.33


class Sign(StrEnum):
    """What is known about one direction in the image."""

    WAITING = "waiting"
    RIGHT = "right"
    REVERSED = "reversed"
    TURNED_RIGHT = "turned a quarter clockwise"
    TURNED_LEFT = "turned a quarter anticlockwise"
    UNCLEAR = "unclear"


@dataclass(frozen=True, slots=True)
class DirectionJudgement:
    """What is known of one of the image's directions.

    Attributes:
        sign: see there.
        gain: motion seen over motion expected, 1 if the lens is as described; NaN before there is
            enough.
        share: how much of the motion needed was made, 0 to 1.
    """

    sign: Sign
    gain: float
    share: float


@dataclass(frozen=True, slots=True)
class SignJudgement:
    """What is known of the image's two directions.

    Attributes:
        across: rightwards.
        down: downwards.
        attitude_stands: the image moves much and the attitude hardly.
    """

    across: DirectionJudgement
    down: DirectionJudgement
    attitude_stands: bool

    @property
    def signs(self) -> tuple[Sign, Sign]:
        """Across and down."""
        return self.across.sign, self.down.sign

    @property
    def passed(self) -> bool:
        """Whether both directions are right."""
        return self.signs == (Sign.RIGHT, Sign.RIGHT)

    @property
    def is_wrong(self) -> bool:
        """Whether one of them is known to be wrong."""
        return not {Sign.WAITING, Sign.RIGHT}.issuperset(self.signs)


class SignEvidence:
    """Collects what was seen, and forgets it slowly: a target may be moved, and stand again."""

    def __init__(self, mount: CameraMount) -> None:
        self._camera_to_body = mount.camera_to_body
        self._last: tuple[float, Vector, Vector] | None = None
        self._expected = np.zeros((2, 2))
        self._both = np.zeros((2, 2))
        self._expected_path = np.zeros(2)
        self._seen_path = 0.0

    def add(self, time_s: float, ray: Vector, attitude: Attitude) -> None:
        """Take where the target was seen, and the attitude at that time.

        Args:
            time_s: when the image was taken.
            ray: the target's direction in the camera's frame, a unit vector.
            attitude: of the body at that time.
        """
        camera_to_world = (
            rotation(attitude.roll_rad, attitude.pitch_rad, attitude.yaw_rad) @ self._camera_to_body
        )
        if self._last is not None:
            last_s, last_ray, last_turn = self._last
            if 0 <= time_s - last_s < _LEAST_INTERVAL_S:
                return
            if 0 <= time_s - last_s <= _LONGEST_INTERVAL_S:
                expected = _angles(camera_to_world.T @ last_turn @ last_ray) - _angles(last_ray)
                self._fold_in(expected, _angles(ray) - _angles(last_ray))
        self._last = time_s, ray, camera_to_world

    def judge(self) -> SignJudgement:
        """Return what is known by now."""
        matrix = self._both @ np.linalg.inv(self._expected + _RIDGE * np.eye(2))
        stands = self._seen_path > _PLENTY_RAD and self._expected_path.sum() < _LITTLE_RAD
        return SignJudgement(self._direction(matrix, 0), self._direction(matrix, 1), bool(stands))

    def _direction(self, matrix: Vector, axis: int) -> DirectionJudgement:
        share = min(float(self._expected_path[axis]) / _ENOUGH_RAD, 1.0)
        gain = float(matrix[axis, axis]) if share >= 1.0 else math.nan
        return DirectionJudgement(self._sign(matrix, axis), gain, share)

    def _fold_in(self, expected: Vector, seen: Vector) -> None:
        for sums in (self._expected, self._both, self._expected_path):
            sums *= _FORGET
        self._expected += np.outer(expected, expected)
        self._both += np.outer(seen, expected)
        self._expected_path += np.abs(expected)
        self._seen_path = _FORGET * self._seen_path + float(np.abs(seen).sum())

    def _sign(self, matrix: Vector, axis: int) -> Sign:
        if self._expected_path[axis] < _ENOUGH_RAD:
            return Sign.WAITING
        along, aside = matrix[axis, axis], matrix[1 - axis, axis]
        if abs(along) >= _CLEAR and abs(aside) < _SMALL * max(1.0, abs(along)):
            return Sign.RIGHT if along > 0 else Sign.REVERSED
        if abs(aside) >= _CLEAR and abs(along) < _SMALL:
            clockwise = aside > 0 if axis == 0 else aside < 0
            return Sign.TURNED_RIGHT if clockwise else Sign.TURNED_LEFT
        return Sign.UNCLEAR


class Reaction:
    """Fits the change of the yaw rate asked for to the change of the heading.

    The vehicle is turned right by hand, the target stands: it is left of the nose now, and the turn
    asked for has to go to the left. The other way round the vehicle would spin away from it.
    """

    def __init__(self) -> None:
        self._last: tuple[float, float, float] | None = None
        self._squares = self._products = self._path = 0.0

    def add(self, time_s: float, yaw_rad: float, asked_rad_s: float) -> None:
        """Take the heading and the yaw rate asked for at one time."""
        if self._last is not None:
            last_s, last_yaw, last_asked = self._last
            if 0 <= time_s - last_s < _LEAST_INTERVAL_S:
                return
            if 0 <= time_s - last_s <= _LONGEST_INTERVAL_S:
                self._fold_in(wrap_angle(yaw_rad - last_yaw), asked_rad_s - last_asked)
        self._last = time_s, yaw_rad, asked_rad_s

    def judge(self) -> Sign:
        """Return what is known by now."""
        if self._path < _ENOUGH_RAD:
            return Sign.WAITING
        slope = self._products / self._squares
        if abs(slope) < _CLEAR_PER_S:
            return Sign.UNCLEAR
        return Sign.RIGHT if slope < 0 else Sign.REVERSED

    def _fold_in(self, turned_rad: float, changed_rad_s: float) -> None:
        self._path = _FORGET * self._path + abs(turned_rad)
        self._squares = _FORGET * self._squares + turned_rad**2
        self._products = _FORGET * self._products + turned_rad * changed_rad_s


def gain_remark(gain: float) -> str:
    """Return what a gain says about the lens, "" if nothing."""
    if math.isnan(gain) or _LEAST_GAIN <= gain <= _MOST_GAIN:
        return ""
    how = "less" if gain < 1 else "more"
    # The lens turns pixels into angles: too wide a field of view makes them too large.
    wrong = "too narrow" if gain < 1 else "too wide"
    return (
        f"the image moves {gain:.1f} times as far as the attitude says, {how} than it should: "
        f"is the target far enough (5 m), is camera.fov_deg {wrong}?"
    )


def _angles(ray: Vector) -> Vector:
    """Return the angles right and down of the optical axis."""
    return np.array([math.atan2(ray[0], ray[2]), math.atan2(ray[1], ray[2])])


DryRunCommand: TypeAlias = tuple[VelocitySetpoint, LineOfSight]
"""What the servo asks for, and the target's direction from the nose (azimuth) and the horizon
(elevation), in rad."""
SignObservation: TypeAlias = tuple[float, Vector, Attitude]
"""When the image was taken (s, the camera's latency taken off), the target's direction in the
camera's frame, and the body's attitude at that time."""


class DryRun:
    """Observer, estimator and servo of the real pipeline, in `chase` mode.

    The loops have no memory here: an integral would grow while the vehicle cannot follow, and then
    hide which way an error is answered.

    Args:
        settings: all of them.
        camera: intrinsics at the size of the frames.
    """

    def __init__(self, settings: Settings, camera: CameraModel) -> None:
        mount, self._latency_s = settings.camera.mount, settings.camera.latency_s
        self._camera = camera
        self._attitudes = AttitudeHistory()
        self._observer = BearingObserver(camera, mount, self._latency_s)
        self._estimator = TargetEstimator(settings.estimator)
        self._servo = VisualServo(_memoryless(settings.servo), mount.pitch_rad)
        self._captured_s = float("-inf")
        self._asked = VelocitySetpoint()

    def step(
        self,
        now_s: float,
        track: Track | None,
        vehicle: VehicleState,
        attitudes: Sequence[Attitude],
    ) -> tuple[DryRunCommand | None, SignObservation | None]:
        """Do one step.

        Args:
            now_s: time of this step.
            track: vision's newest answer.
            vehicle: newest telemetry.
            attitudes: those that came since the last step.

        Returns:
            What would be asked for, None without an estimate; and the observation, None unless
            `track` is a new one that sees the target.
        """
        for attitude in attitudes:
            self._attitudes.add(attitude)
        observation = None if track is None else self._observe(track)
        estimate, attitude_now = self._estimator.estimate(now_s), vehicle.attitude
        if estimate is None or attitude_now is None:
            return None, observation
        self._asked = self._servo.update(estimate, vehicle, self._asked)
        azimuth = wrap_angle(estimate.azimuth_rad - attitude_now.yaw_rad)
        direction = LineOfSight(azimuth, estimate.elevation_rad)
        return (self._asked, direction), observation

    def _observe(self, track: Track) -> SignObservation | None:
        if track.state is not TrackState.TRACKING or track.captured_s <= self._captured_s:
            return None
        self._captured_s = track.captured_s
        bearing = self._observer.observe(track, self._attitudes)
        attitude = self._attitudes.at(track.captured_s - self._latency_s)
        if bearing is None or attitude is None:
            return None
        self._estimator.observe(bearing)
        ray = self._camera.rays([(track.box.cx, track.box.cy)])[0]
        return bearing.time_s, ray, attitude


def _memoryless(servo: ServoSettings) -> ServoSettings:
    return replace(
        servo,
        mode=FollowMode.CHASE,
        azimuth=replace(servo.azimuth, ki=0.0, kd=0.0),
        elevation=replace(servo.elevation, ki=0.0, kd=0.0),
        range=replace(servo.range, ki=0.0, kd=0.0),
    )
