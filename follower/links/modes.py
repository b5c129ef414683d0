"""Flight modes by their names, for both autopilots."""

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

_PX4_EXTRA = {(4, 1): "READY", (4, 9): "PRECLAND"}
"""Sub-modes that pymavlink 2.4.50 does not name (px4_custom_mode.h)."""


def mode_name(autopilot: int, custom_mode: int) -> str:
    """Return the name of a heartbeat's mode, e.g. "OFFBOARD" or "GUIDED"."""
    if autopilot == mavlink.MAV_AUTOPILOT_PX4:
        name = str(mavutil.interpret_px4_mode(0, custom_mode))
        main_and_sub = (custom_mode >> 16) & 0xFF, custom_mode >> 24
        return _PX4_EXTRA.get(main_and_sub, name) if name == "UNKNOWN" else name
    return str(mavutil.mode_mapping_acm.get(custom_mode, f"MODE {custom_mode}"))


def setpoint_mode(autopilot: int) -> str:
    """Return the mode in which the autopilot flies velocity setpoints."""
    return "OFFBOARD" if autopilot == mavlink.MAV_AUTOPILOT_PX4 else "GUIDED"


def hold_mode(autopilot: int) -> str:
    """Return the mode in which the autopilot stands still by itself."""
    return "LOITER" if autopilot == mavlink.MAV_AUTOPILOT_PX4 else "BRAKE"


def set_mode_params(autopilot: int, name: str) -> tuple[float, float, float]:
    """Return parameters 1 to 3 of MAV_CMD_DO_SET_MODE for a mode by its name.

    Raises:
        ValueError: the autopilot has no mode of that name.
    """
    custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    if autopilot == mavlink.MAV_AUTOPILOT_PX4:
        if name not in mavutil.px4_map:
            raise ValueError(f"PX4 has no mode {name!r}; it has {', '.join(mavutil.px4_map)}")
        _, main, sub = mavutil.px4_map[name]
        return custom, float(main), float(sub)
    numbers = {mode: number for number, mode in mavutil.mode_mapping_acm.items()}
    if name not in numbers:
        raise ValueError(f"ArduCopter has no mode {name!r}; it has {', '.join(numbers)}")
    return custom, float(numbers[name]), 0.0
