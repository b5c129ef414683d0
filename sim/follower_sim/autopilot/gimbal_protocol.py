"""The gimbal protocol as the simulated autopilot speaks it: manager and device in one."""

import math
from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink
from pymavlink.quaternion import QuaternionBase

from follower_sim.vehicle.gimbal import Gimbal

_DEVICE = 1
_LOCKS = (
    mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
)
_CAPABILITIES = (
    mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_AXIS
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_PITCH_LOCK
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_AXIS
    | mavlink.GIMBAL_MANAGER_CAP_FLAGS_HAS_YAW_LOCK
)
_ACCEPTED, _DENIED = int(mavlink.MAV_RESULT_ACCEPTED), int(mavlink.MAV_RESULT_DENIED)


class GimbalProtocol:
    """Obeys rates from whoever controls the gimbal, and reports its attitude.

    Attributes:
        holder: system and component that control it; nobody at first.
    """

    def __init__(self, gimbal: Gimbal) -> None:
        self._gimbal = gimbal
        self.holder = (0, 0)

    def configure(self, params: Sequence[float], sender: tuple[int, int]) -> int:
        """Do MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE; return the MAV_RESULT."""
        system, component = (int(p) if math.isfinite(p) else -1 for p in params[:2])
        if system == -2:
            self.holder = sender
        elif system == -3 and self.holder == sender:
            self.holder = (0, 0)
        elif system >= 0 and component >= 0:
            self.holder = system, component
        elif system not in (-1, -3):
            return _DENIED
        return _ACCEPTED

    def take(self, message: Any) -> None:
        """Take GIMBAL_MANAGER_SET_ATTITUDE: rates against the world, the only kind simulated."""
        rates = message.angular_velocity_y, message.angular_velocity_z
        sender = message.get_srcSystem(), message.get_srcComponent()
        locked = bool(message.flags & mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK)
        by_rate = math.isnan(message.q[0]) and all(map(math.isfinite, rates))
        if (
            sender == self.holder
            and locked
            and by_rate
            and message.gimbal_device_id in (0, _DEVICE)
        ):
            self._gimbal.wanted = rates

    def attitude_status(self, boot_ms: int) -> Any:
        """Return GIMBAL_DEVICE_ATTITUDE_STATUS."""
        state = self._gimbal.state
        flags = _LOCKS | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
        return mavlink.MAVLink_gimbal_device_attitude_status_message(
            *(0, 0, boot_ms, flags),
            QuaternionBase(state.attitude_rad).q.tolist(),
            *state.rates_rad_s,
            0,
            gimbal_device_id=_DEVICE,
        )

    def information(self, boot_ms: int) -> Any:
        """Return GIMBAL_MANAGER_INFORMATION."""
        model = self._gimbal.model
        pitch = math.radians(model.lowest_deg), math.radians(model.highest_deg)
        yaw = math.radians(model.widest_deg)
        return mavlink.MAVLink_gimbal_manager_information_message(
            boot_ms, _CAPABILITIES, _DEVICE, 0.0, 0.0, *pitch, -yaw, yaw
        )

    def status(self, boot_ms: int) -> Any:
        """Return GIMBAL_MANAGER_STATUS."""
        return mavlink.MAVLink_gimbal_manager_status_message(
            boot_ms, _LOCKS, _DEVICE, *self.holder, 0, 0
        )
