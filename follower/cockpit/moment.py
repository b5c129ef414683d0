"""What the page is told of the flight ten times a second."""

from __future__ import annotations

import math

from follower.flightlog import ControlRecord
from follower.live_status import LiveStatus
from follower.station.wire import Message
from follower_control.setpoint import VelocitySetpoint


def moment(status: LiveStatus, record: ControlRecord | None) -> Message:
    """Return a moment as plain values, in the page's units: angles in degrees.

    Args:
        status: what any display shows.
        record: the newest control step.
    """
    azimuth, elevation = status.azimuth_error_rad, status.elevation_error_rad
    return {
        "time_s": _finite(status.elapsed_s),
        "total_s": status.total_s,
        "state": status.state,
        "reason": status.reason,
        "phase": status.phase,
        "azimuth_deg": None if azimuth is None else _finite(math.degrees(azimuth)),
        "elevation_deg": None if elevation is None else _finite(math.degrees(elevation)),
        "range_m": _finite(status.range_m),
        "asked": _velocity(status.asked),
        "allowed": _velocity(status.allowed),
        "flown": _velocity(status.flown),
        "limits": [] if record is None else list(record.limits),
        "track": status.track,
        "confidence": _finite(status.confidence),
        "frame_rate_hz": _finite(status.frame_rate_hz),
        "vision_ms": _finite(None if status.vision_s is None else 1000 * status.vision_s),
        "control_ms": _finite(None if status.control_s is None else 1000 * status.control_s),
        "link": status.link,
        **_vehicle(record),
    }


def _vehicle(record: ControlRecord | None) -> Message:
    if record is None:
        return {"mode": "", "armed": False, "height_m": None, "consent": False, "stopped": False}
    vehicle, situation = record.vehicle, record.situation
    return {
        "mode": vehicle.mode or "",
        "armed": bool(vehicle.armed),
        "height_m": None if vehicle.position is None else _finite(vehicle.position.height_m),
        "consent": situation is not None and situation.consent_given,
        "stopped": situation is not None and situation.stop_requested,
    }


def _velocity(setpoint: VelocitySetpoint | None) -> list[float] | None:
    """Return forward, right and down in m/s, yaw rate in degrees a second."""
    if setpoint is None:
        return None
    yaw_deg_s = math.degrees(setpoint.yaw_rate_rad_s)
    values = (setpoint.forward_m_s, setpoint.right_m_s, setpoint.down_m_s, yaw_deg_s)
    return [round(value, 4) for value in values] if all(map(math.isfinite, values)) else None


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 4)
