"""The gimbal manager, as seen from the companion computer."""

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower_control.vehicle.gimbal import GimbalRates

_EVERY_S = 1.0
_AGAIN_S = 3.0
"""By then the manager has said twice who controls the gimbal since it was last asked for."""
_ALL_LOCKED = (
    mavlink.GIMBAL_MANAGER_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_MANAGER_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_MANAGER_FLAGS_YAW_LOCK
)
"""Angles and rates are against the world: the vehicle may turn and tilt under the camera."""
_NOBODY = (0, 0)

Command = tuple[int, tuple[float, ...]]


class GimbalManager:
    """Finds the gimbal, asks for its control, and knows who has it.

    Asked for once, and again while the manager says that nobody has it: the command may get lost,
    and an autopilot that was restarted has forgotten it. Whoever takes it afterwards, keeps it.

    Args:
        system, component: who we are.
        device: which gimbal, as the manager counts; 0 is the first, or all.

    Attributes:
        found: the manager has announced its gimbal.
        holder: system and component that control it, as far as is known.
    """

    def __init__(self, system: int, component: int, device: int) -> None:
        self._own = system, component
        self._device = device
        self._asked_s = -math.inf
        self._taken = False
        self.found = False
        self.holder: tuple[int, int] | None = None

    @property
    def obeys_us(self) -> bool:
        """Whether nobody else controls it."""
        return self.holder in (None, _NOBODY, self._own)

    def take(self, name: str, message: Any) -> bool:
        """Take a message of the manager; whether it is one."""
        if name == "GIMBAL_MANAGER_INFORMATION":
            self.found = True
        elif name == "GIMBAL_MANAGER_STATUS":
            if self._device not in (0, message.gimbal_device_id):
                return True  # another gimbal's
            self.holder = message.primary_control_sysid, message.primary_control_compid
        else:
            return False
        return True

    def due(self, now_s: float) -> list[Command]:
        """Return the commands whose time has come."""
        waited_s = now_s - self._asked_s
        if not self.found:
            if waited_s < _EVERY_S:
                return []
            self._asked_s = now_s
            number = float(mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION)
            return [(mavlink.MAV_CMD_REQUEST_MESSAGE, (number,))]
        if self._taken and (self.holder != _NOBODY or waited_s < _AGAIN_S):
            return []
        self._taken, self._asked_s = True, now_s
        # The last four: secondary control and two unused ones stay as they are.
        take = (*map(float, self._own), -1.0, -1.0, 0.0, 0.0, float(self._device))
        return [(mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE, take)]

    def rates_message(self, rates: GimbalRates, system: int) -> Any:
        """Return the message that turns the gimbal; both autopilots take rates without angles."""
        nan = math.nan
        return mavlink.MAVLink_gimbal_manager_set_attitude_message(
            system,
            mavlink.MAV_COMP_ID_AUTOPILOT1,
            _ALL_LOCKED,
            self._device,
            [nan, nan, nan, nan],
            0.0,
            rates.pitch_rad_s,
            rates.yaw_rad_s,
        )
