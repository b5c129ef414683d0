"""The laws that fly, run without a supervisor and without anything being sent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from follower.settings import Settings
from follower_control.attitude_history import AttitudeHistory
from follower_control.estimator import TargetEstimator
from follower_control.servo import VisualServo
from follower_control.servo_settings import Mode, ServoSettings
from follower_control.setpoint import VelocitySetpoint
from follower_control.sighter import Sighter
from follower_control.vehicle import Attitude, VehicleState
from follower_vision.camera import CameraModel, Vector
from follower_vision.lineofsight import LineOfSight, wrap_angle
from follower_vision.track import Track, TrackState


@dataclass(frozen=True, slots=True)
class Wish:
    """What would be sent now, and where the target is.

    Attributes:
        setpoint: what the servo asks for.
        sight: the target from the nose (azimuth) and the horizon (elevation).
        range_m: as the servo believes.
    """

    setpoint: VelocitySetpoint
    sight: LineOfSight
    range_m: float


@dataclass(frozen=True, slots=True)
class Look:
    """One sight of the target with the attitude at that time.

    Attributes:
        time_s: when the image was taken, the camera's latency taken off.
        ray: direction in the camera's frame.
        attitude: of the body.
    """

    time_s: float
    ray: Vector
    attitude: Attitude


class DryRun:
    """Sighter, estimator and servo of the real pipeline, in `chase` mode.

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
        self._sighter = Sighter(camera, mount, self._latency_s)
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
    ) -> tuple[Wish | None, Look | None]:
        """Do one step.

        Args:
            now_s: time of this step.
            track: vision's newest answer.
            vehicle: newest telemetry.
            attitudes: those that came since the last step.

        Returns:
            What would be asked for, None without an estimate; and the sight, None unless `track`
            is a new one that sees the target.
        """
        for attitude in attitudes:
            self._attitudes.add(attitude)
        look = None if track is None else self._look(track)
        estimate, attitude_now = self._estimator.estimate(now_s), vehicle.attitude
        if estimate is None or attitude_now is None:
            return None, look
        self._asked = self._servo.update(estimate, vehicle, self._asked)
        azimuth = wrap_angle(estimate.azimuth_rad - attitude_now.yaw_rad)
        errors = self._servo.errors
        range_m = float("nan") if errors is None else errors.range_m
        return Wish(self._asked, LineOfSight(azimuth, estimate.elevation_rad), range_m), look

    def _look(self, track: Track) -> Look | None:
        if track.state is not TrackState.TRACKING or track.captured_s <= self._captured_s:
            return None
        self._captured_s = track.captured_s
        sighting = self._sighter.sight(track, self._attitudes)
        attitude = self._attitudes.at(track.captured_s - self._latency_s)
        if sighting is None or attitude is None:
            return None
        self._estimator.observe(sighting)
        ray = self._camera.rays([(track.box.cx, track.box.cy)])[0]
        return Look(sighting.time_s, ray, attitude)


def _memoryless(servo: ServoSettings) -> ServoSettings:
    return replace(
        servo,
        mode=Mode.CHASE,
        azimuth=replace(servo.azimuth, ki=0.0, kd=0.0),
        elevation=replace(servo.elevation, ki=0.0, kd=0.0),
        range=replace(servo.range, ki=0.0, kd=0.0),
    )
