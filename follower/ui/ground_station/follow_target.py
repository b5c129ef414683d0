"""The target's position for autopilots that can follow one: FOLLOW_TARGET, GLOBAL_POSITION_INT."""

import math
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.settings.ui import GroundStationSettings, TargetMessage
from follower.ui.ground_station.endpoint import Endpoint
from follower.ui.ground_station.flight_view import FlightView, GeoPosition, target_place

_POSITION, _VELOCITY = 1 << 0, 1 << 1
_SEEN_WITHIN_S = 1.0
_LARGEST = 2**15 - 1


class TargetReport:
    """Sends the target's position as a system of its own, while it is seen; no thread, no clock.

    Args:
        settings: which messages, and how often.
        endpoint: sends as the target.
        view: of the flight.
    """

    def __init__(
        self, settings: GroundStationSettings, endpoint: Endpoint, view: FlightView
    ) -> None:
        self._settings = settings
        self._endpoint = endpoint
        self._view = view
        self._told_s = -math.inf

    def step(self, now_s: float) -> None:
        """Send what is due at `now_s`, in seconds."""
        if now_s - self._told_s < 0.95 / self._settings.target_rate_hz:
            return
        place = target_place(self._view, now_s)
        step = self._view.step(now_s)
        if place is None or step is None or step.estimate is None:
            return
        if step.estimate.age_s > _SEEN_WITHIN_S:
            return
        self._told_s = now_s
        boot_ms = round(1000 * place.fix.time_s)
        kind = self._settings.target
        if kind in (TargetMessage.FOLLOW_TARGET, TargetMessage.BOTH):
            self._endpoint.send(follow_target(place, boot_ms))
        if kind in (TargetMessage.GLOBAL_POSITION, TargetMessage.BOTH):
            self._endpoint.send(global_position(place, boot_ms))


def follow_target(place: GeoPosition, boot_ms: int) -> Any:
    """Return FOLLOW_TARGET; its covariance is horizontal and vertical deviation in metres."""
    fix = place.fix
    return mavlink.MAVLink_follow_target_message(
        boot_ms,
        _POSITION | _VELOCITY,
        round(place.latitude_deg * 1e7),
        round(place.longitude_deg * 1e7),
        place.altitude_m,
        list(fix.velocity_m_s),
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [fix.horizontal_m, fix.vertical_m, 0.0],
        0,
    )


def global_position(place: GeoPosition, boot_ms: int) -> Any:
    """Return GLOBAL_POSITION_INT, which has no place for covariance; the heading is the course."""
    north, east, down = place.fix.velocity_m_s
    course_deg = math.degrees(math.atan2(east, north)) % 360.0
    return mavlink.MAVLink_global_position_int_message(
        boot_ms % 2**32,
        round(place.latitude_deg * 1e7),
        round(place.longitude_deg * 1e7),
        round(place.altitude_m * 1000),
        round(place.above_home_m * 1000),
        *(min(max(round(100 * v), -_LARGEST), _LARGEST) for v in (north, east, down)),
        round(course_deg * 100) % 36000,
    )
