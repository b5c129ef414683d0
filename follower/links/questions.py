"""What a link asks its vehicle for: messages at their rates, the time, health and mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from follower.links import ekf_status_report
from follower.links.gimbal_manager import GimbalManager
from follower.links.health_monitor import HealthMonitor
from follower.links.link_settings import LinkSettings
from follower.links.message_rates import MessageRates
from follower.links.timesync import TimeSync
from follower.links.vehicle_finder import Vehicle

_RC = "RC_CHANNELS"
_GIMBAL_HZ, _GIMBAL_STATUS_HZ, _ORIGIN_HZ, _HEALTH_HZ = 50.0, 1.0, 0.5, 1.0
_NOT_EVERYWHERE = (
    _RC,
    "DISTANCE_SENSOR",
    "TERRAIN_REPORT",
    "GPS_GLOBAL_ORIGIN",
    "GIMBAL_MANAGER_STATUS",
)
_ASK_VERSION_S = 1.0
_SLACK_S = 1e-6


@dataclass(frozen=True, slots=True)
class Voice:
    """How a link asks.

    Attributes:
        command: sends a command to the autopilot, with its parameters.
        message: asks for one message, once, by its number; nobody waits for an answer.
        parameter: asks for a parameter by its name.
        timesync: sends a TIMESYNC message.
    """

    command: Callable[..., None]
    message: Callable[[int], None]
    parameter: Callable[[str], None]
    timesync: Callable[[int, int], None]


class Questions:
    """Asks for what does not come by itself, and again when it stops.

    Args:
        settings: see there.
        timesync: whose questions are asked too.
        voice: of the link.
    """

    def __init__(self, settings: LinkSettings, timesync: TimeSync, voice: Voice) -> None:
        self._settings = settings
        self._timesync = timesync
        self._voice = voice
        rates = {
            "ATTITUDE": settings.attitude_rate_hz,
            "LOCAL_POSITION_NED": settings.position_rate_hz,
            "GLOBAL_POSITION_INT": 2.0,
            "EXTENDED_SYS_STATE": 5.0,
            _RC: settings.rc_rate_hz,
            "DISTANCE_SENSOR": settings.clearance_rate_hz,
            "TERRAIN_REPORT": settings.clearance_rate_hz,
            "GPS_GLOBAL_ORIGIN": _ORIGIN_HZ,
        }
        wanted = {name: rate for name, rate in rates.items() if rate > 0}
        self.rates = MessageRates(wanted, optional=_NOT_EVERYWHERE)
        self._watches_health = False
        self._mode_asked_s = self._version_asked_s = float("-inf")

    def watch_gimbal(self) -> None:
        """From now on want a gimbal's attitude and who controls it."""
        self.rates.want("GIMBAL_DEVICE_ATTITUDE_STATUS", _GIMBAL_HZ)
        self.rates.want("GIMBAL_MANAGER_STATUS", _GIMBAL_STATUS_HZ)

    def watch_health(self, vehicle: Vehicle | None) -> None:
        """From now on want health; of a vehicle that is not found yet, once it is."""
        self._watches_health = True
        if vehicle is not None:
            self.begin(vehicle)

    def begin(self, vehicle: Vehicle) -> None:
        """Want what this kind of autopilot can tell."""
        if self._watches_health:
            px4 = vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4
            estimator = "ESTIMATOR_STATUS" if px4 else ekf_status_report.NAME
            for name in ("SYS_STATUS", "GPS_RAW_INT", estimator):
                self.rates.want(name, _HEALTH_HZ)

    def ask(
        self,
        now_s: float,
        steered: bool,
        health: HealthMonitor | None,
        gimbal: GimbalManager | None,
    ) -> list[str]:
        """Ask for the time and for what does not come; return what is to be told of the rates.

        Args:
            now_s: the time.
            steered: whether the autopilot obeys setpoints, or may by now: then its mode is asked
                for often.
            health: what is known of it.
            gimbal: whose questions are asked too.
        """
        stamp = self._timesync.question(now_s)
        if stamp is not None:
            self._voice.timesync(0, stamp)
        notes = list(self.rates.changes(now_s))
        if steered:
            self._ask_for_mode(now_s)
        for rate in self.rates.due(now_s):
            number = float(_message_id(rate.name))
            self._voice.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate.wanted_hz)
        if health is not None:
            self._ask_about_health(health, now_s)
        if gimbal is not None:
            for command, params in gimbal.due(now_s):
                self._voice.command(command, *params)
        return notes

    def _ask_for_mode(self, now_s: float) -> None:
        """Ask for a heartbeat out of turn, to see soon when the pilot takes another mode.

        PX4 refuses to send heartbeats at another rate than 1 Hz.
        """
        rate_hz = self._settings.mode_rate_hz
        if rate_hz > 0 and now_s - self._mode_asked_s >= 1 / rate_hz - _SLACK_S:
            self._mode_asked_s = now_s
            self._voice.message(mavlink.MAVLINK_MSG_ID_HEARTBEAT)

    def _ask_about_health(self, health: HealthMonitor, now_s: float) -> None:
        for name in health.parameters.due(now_s):
            self._voice.parameter(name)
        unknown = self._watches_health and health.health.firmware is None
        if unknown and now_s - self._version_asked_s >= _ASK_VERSION_S:
            self._version_asked_s = now_s
            number = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            self._voice.command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)


def _message_id(name: str) -> int:
    if name == ekf_status_report.NAME:
        return ekf_status_report.MESSAGE_ID
    return int(getattr(mavlink, f"MAVLINK_MSG_ID_{name}"))
