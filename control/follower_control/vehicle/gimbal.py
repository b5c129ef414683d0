"""The rates that a gimbal is given, and the attitude of its camera."""

from dataclasses import dataclass, replace

from follower_control.common.small_matrix import product
from follower_control.vehicle.history import AttitudeHistory
from follower_control.vehicle.state import Attitude, GimbalState
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import along_camera_axes, rotation


@dataclass(frozen=True, slots=True)
class GimbalRates:
    """How fast a gimbal's camera is to turn, against the world.

    Attributes:
        pitch_rad_s: up is positive.
        yaw_rad_s: to the right is positive.
    """

    pitch_rad_s: float = 0.0
    yaw_rad_s: float = 0.0


STILL = GimbalRates()
"""Keep looking where it looks."""


def camera_to_world(gimbal: GimbalState, vehicle: Attitude) -> Vector:
    """Return the 3x3 matrix from camera axes (right, down, forward) to the world's.

    Args:
        gimbal: how it holds the camera.
        vehicle: its attitude at the same time.
    """
    camera = gimbal.attitude
    if not gimbal.is_level:
        body = rotation(vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
        yaw = camera.yaw_rad - (vehicle.yaw_rad if gimbal.from_north else 0.0)
        turn = rotation(camera.roll_rad, camera.pitch_rad, yaw)
        return along_camera_axes(product(body, turn))
    yaw = camera.yaw_rad + (0.0 if gimbal.from_north else vehicle.yaw_rad)
    return along_camera_axes(rotation(camera.roll_rad, camera.pitch_rad, yaw))


class GimbalHistory:
    """Looks up how the camera was held when a frame was taken; used by one thread.

    What its angles are measured against may change: then it begins anew.
    """

    def __init__(self) -> None:
        self._attitudes = AttitudeHistory()
        self._newest: GimbalState | None = None

    def add(self, state: GimbalState) -> bool:
        """Remember a state; False if it is not finite or not newer than the newest one."""
        newest = self._newest
        kind = (state.is_level, state.from_north)
        if newest is not None and kind != (newest.is_level, newest.from_north):
            self._attitudes.clear()
        if not self._attitudes.add(state.attitude):
            return False
        self._newest = state
        return True

    def at(self, time_s: float) -> GimbalState | None:
        """Return the state at a time, None where it is not known."""
        attitude = self._attitudes.at(time_s)
        if attitude is None or self._newest is None:
            return None
        return replace(self._newest, attitude=attitude)
