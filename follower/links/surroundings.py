"""Messages about what is below the vehicle, around it, and in its gimbal."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower_control.vehicle import Attitude, Clearance, GimbalState, Origin

_LEVEL = mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
_FROM_NORTH = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
_FROM_NOSE = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
_LOCKED = mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK


def clearance_by_rangefinder(message: Any, time_s: float) -> Clearance | None:
    """Return what a DISTANCE_SENSOR that looks down says; None if it sees no ground."""
    looks_down = message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270
    within = message.min_distance < message.current_distance < message.max_distance
    if not looks_down or not within or message.signal_quality == 1:
        return None
    return Clearance(message.current_distance / 100.0, time_s)


def clearance_by_terrain(message: Any, time_s: float) -> Clearance | None:
    """Return what a TERRAIN_REPORT says; None while the terrain's map is not loaded."""
    if message.loaded == 0 or message.pending > 0 or not math.isfinite(message.current_height):
        return None
    return Clearance(float(message.current_height), time_s)


def origin_of(message: Any) -> Origin | None:
    """Return what a GPS_GLOBAL_ORIGIN says; None if it is none."""
    if message.latitude == 0 and message.longitude == 0:
        return None
    return Origin(message.latitude / 1e7, message.longitude / 1e7)


def gimbal_of(message: Any, time_s: float) -> GimbalState | None:
    """Return what a GIMBAL_DEVICE_ATTITUDE_STATUS says; None if it is not finite."""
    quaternion = [_number(value) for value in message.q]
    size = math.sqrt(sum(value * value for value in quaternion))
    if not (math.isfinite(size) and 0.5 < size < 2.0):
        return None
    roll, pitch, yaw = _angles([value / size for value in quaternion])
    rates = (message.angular_velocity_x, message.angular_velocity_y, message.angular_velocity_z)
    known = [rate if math.isfinite(rate) else 0.0 for rate in map(_number, rates)]
    flags = int(message.flags)
    from_north = bool(flags & _FROM_NORTH) or (not flags & _FROM_NOSE and bool(flags & _LOCKED))
    attitude = Attitude(roll, pitch, yaw, known[0], known[1], known[2], time_s)
    return GimbalState(attitude, flags & _LEVEL == _LEVEL, from_north)


def _number(value: Any) -> float:
    """Return a number; what came as no number, as JSON has it, is NaN."""
    return math.nan if value is None else float(value)


def _angles(q: list[float]) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a unit quaternion (w, x, y, z), aerospace order."""
    w, x, y, z = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw
