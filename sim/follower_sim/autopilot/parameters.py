"""The autopilots' parameters with their defaults, as far as somebody reads them.

An integer parameter has an integer for its default; ArduPilot's 8 and 16 bits are sent as 32.

PX4 1.18: src/modules/commander, mc_pos_control, mc_rate_control. ArduCopter 4.6: Parameters.cpp,
AC_WPNav, AC_AttitudeControl.
"""

import math
import struct
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

PX4_PARAMETERS: dict[str, float] = {
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 3,
    "MAV_SYS_ID": 1,
    "MC_YAWRATE_MAX": 200.0,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_MAN_Y_MAX": 150.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
}

ARDUCOPTER_PARAMETERS: dict[str, float] = {
    "ATC_ACCEL_Y_MAX": 27000.0,
    "ATC_SLEW_YAW": 6000.0,
    "FS_GCS_ENABLE": 0,
    "FS_OPTIONS": 16,
    "FS_THR_ENABLE": 1,
    "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0,
    "PSC_JERK_XY": 5.0,
    "SYSID_MYGCS": 255,
    "SYSID_THISMAV": 1,
    "WPNAV_ACCEL": 250.0,
    "WPNAV_ACCEL_Z": 100.0,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0,
}

INT32, REAL32 = 6, 9
"""MAV_PARAM_TYPE."""


class ParameterProtocol:
    """Reports parameters and takes new values.

    PX4 puts an integer's four bytes where the message has a float; ArduPilot converts it to a
    float. PX4 refuses to set a value of another type than the parameter's. Both keep silent about
    a parameter that they do not have.

    Args:
        parameters: by name; altered by PARAM_SET.
        bytewise: PX4's encoding.
        send: sends a message.
    """

    def __init__(
        self, parameters: dict[str, float], bytewise: bool, send: Callable[[Any], None]
    ) -> None:
        self._parameters = parameters
        self._types = {n: INT32 if isinstance(x, int) else REAL32 for n, x in parameters.items()}
        self._bytewise = bytewise
        self._send = send

    def read(self, m: Any) -> None:
        """Answer PARAM_REQUEST_READ, by index or by name."""
        names = list(self._parameters)
        if 0 <= m.param_index < len(names):
            self._report(names[m.param_index])
        elif m.param_index == -1:
            self._report(m.param_id)

    def list(self, _m: Any) -> None:
        """Answer PARAM_REQUEST_LIST."""
        for name in self._parameters:
            self._report(name)

    def set(self, m: Any) -> None:
        """Take PARAM_SET and answer with the value that holds now."""
        if m.param_id not in self._parameters:
            return
        kind = self._types[m.param_id]
        if not self._bytewise or m.param_type == kind:
            value = self._decoded(m.param_value, kind)
            if math.isfinite(value):
                self._parameters[m.param_id] = value
        self._report(m.param_id)

    def _report(self, name: str) -> None:
        if name not in self._parameters:
            return
        kind = self._types[name]
        self._send(
            mavlink.MAVLink_param_value_message(
                name.encode(),
                self._encoded(self._parameters[name], kind),
                kind,
                len(self._parameters),
                list(self._parameters).index(name),
            )
        )

    def _encoded(self, value: float, kind: int) -> float:
        if not self._bytewise or kind == REAL32:
            return value
        return float(struct.unpack("<f", struct.pack("<i", round(value)))[0])

    def _decoded(self, carried: float, kind: int) -> float:
        if kind == REAL32:
            return carried
        if not self._bytewise:
            return float(round(carried)) if math.isfinite(carried) else carried
        return float(struct.unpack("<i", struct.pack("<f", carried))[0])
