"""The autopilots' parameters with their default values and types, as far as somebody reads them.

PX4 1.18: src/modules/commander, mc_pos_control, mc_rate_control. ArduCopter 4.6: Parameters.cpp,
AC_WPNav, AC_AttitudeControl.
"""

from __future__ import annotations

PX4_PARAMETERS: dict[str, float] = {
    "COM_OBL_RC_ACT": 0.0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0.0,
    "COM_RC_IN_MODE": 3.0,
    "MAV_SYS_ID": 1.0,
    "MC_YAWRATE_MAX": 200.0,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_MAN_Y_MAX": 150.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "NAV_DLL_ACT": 0.0,
    "NAV_RCL_ACT": 2.0,
}

ARDUCOPTER_PARAMETERS: dict[str, float] = {
    "ATC_SLEW_YAW": 6000.0,
    "FS_GCS_ENABLE": 0.0,
    "FS_OPTIONS": 16.0,
    "FS_THR_ENABLE": 1.0,
    "GUID_OPTIONS": 0.0,
    "GUID_TIMEOUT": 3.0,
    "PSC_JERK_XY": 5.0,
    "SYSID_MYGCS": 255.0,
    "SYSID_THISMAV": 1.0,
    "WPNAV_ACCEL": 250.0,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0,
}

INT8, INT16, INT32, REAL32 = 2, 4, 6, 9
"""MAV_PARAM_TYPE."""

PARAMETER_TYPES: dict[str, int] = {
    "COM_OBL_RC_ACT": INT32,
    "COM_RCL_EXCEPT": INT32,
    "COM_RC_IN_MODE": INT32,
    "MAV_SYS_ID": INT32,
    "NAV_DLL_ACT": INT32,
    "NAV_RCL_ACT": INT32,
    "FS_GCS_ENABLE": INT8,
    "FS_OPTIONS": INT32,
    "FS_THR_ENABLE": INT8,
    "GUID_OPTIONS": INT32,
    "SYSID_MYGCS": INT16,
    "SYSID_THISMAV": INT16,
}
"""What is not named here is a float."""
