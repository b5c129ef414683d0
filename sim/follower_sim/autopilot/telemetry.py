"""What the simulated autopilot reports, and how often."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower_sim.autopilot.firmware import Behaviour
from follower_sim.autopilot.flight_controller import FlightController
from follower_sim.autopilot.gimbal_protocol import GimbalProtocol
from follower_sim.autopilot.mavlink_endpoint import Faults
from follower_sim.kinematics import BodyState, Triple
from follower_vision.geometry.line_of_sight import wrap_angle

ESTIMATES_ALL = 0x33F
"""Attitude, velocities, positions: what both estimators claim with a GPS, on the ground too."""

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)

_EARTH_RADIUS_M = 6378137.0
_SLACK_S = 1e-9
_FAR_CM = 4000
_CHANNELS, _NO_CHANNEL = 18, 65535
_ANGLE_NOISE_RAD, _RATE_NOISE_RAD_S = 2e-4, 2e-3
"""What an estimator's attitude trembles by: a real one never repeats its numbers."""


@dataclass(slots=True)
class Health:
    """What the autopilot reports of itself; a test or a scenario may change it during the flight.

    Attributes:
        unhealthy: MAV_SYS_STATUS_SENSOR bits of what is not well.
        battery_percent: what is left, -1 if it is not measured.
        fix_type: GPS_FIX_TYPE.
        satellites: in use.
        hdop: horizontal dilution of precision.
        estimates: flags of the estimator's report (the low bits are the same for both).
        test_ratio: innovation over its limit, of all measurements; above 1 they are rejected.
        settled_s: when its estimator has a position, on the simulation's clock. Before that it
            reports no position and does not arm, as a real autopilot does for up to a minute
            after its start.
        fit_s: when it has nothing else against being armed.
        has_rangefinder: one points down and measures the distance to level ground.
    """

    unhealthy: int = 0
    battery_percent: int = 90
    fix_type: int = 3
    satellites: int = 12
    hdop: float = 0.8
    estimates: int = ESTIMATES_ALL
    test_ratio: float = 0.1
    settled_s: float = -math.inf
    fit_s: float = -math.inf
    has_rangefinder: bool = False

    def sys_status(self) -> Any:
        """Return SYS_STATUS."""
        battery = (15800, -1, self.battery_percent)
        well = _SENSORS & ~self.unhealthy
        return mavlink.MAVLink_sys_status_message(
            *(_SENSORS, _SENSORS, well), 300, *battery, *(0, 0, 0, 0, 0, 0)
        )

    def gps_raw_int(self, time_us: int, place: tuple[int, int, int]) -> Any:
        """Return GPS_RAW_INT at (latitude, longitude, altitude) in 1e-7 degrees and mm."""
        dilution = round(100 * self.hdop), round(150 * self.hdop)
        return mavlink.MAVLink_gps_raw_int_message(
            time_us, self.fix_type, *place, *dilution, *(0, 0), self.satellites
        )

    def estimator_status(self, time_us: int) -> Any:
        """Return ESTIMATOR_STATUS, which PX4 sends."""
        ratios = (self.test_ratio,) * 4
        return mavlink.MAVLink_estimator_status_message(
            time_us, self.estimates, *ratios, 0.0, 0.0, 0.4, 0.6
        )

    def ekf_status_report(self) -> Any:
        """Return EKF_STATUS_REPORT, which ArduPilot sends."""
        ratios = (self.test_ratio,) * 4
        return mavlink.MAVLink_ekf_status_report_message(self.estimates, *ratios, 0.0)


class Telemetry:
    """Builds messages and knows when each is due.

    Args:
        controller: whose state is reported.
        faults: what to falsify.
        health: what to report of sensors, battery, GPS and estimator.
        boot_s: the simulation's time at which the autopilot's own clock was 0.
        rng: makes the attitude's noise.
        gimbal: is reported, if there is one.
    """

    def __init__(
        self,
        controller: FlightController,
        faults: Faults,
        health: Health,
        boot_s: float,
        rng: np.random.Generator,
        gimbal: GimbalProtocol | None = None,
    ) -> None:
        self._controller = controller
        self._faults = faults
        self._health = health
        self._boot_s = boot_s
        self._rng = rng
        self._last: dict[str, tuple[float, ...]] = {}
        self._builders: dict[str, Callable[[BodyState], Any]] = {
            "HEARTBEAT": self._heartbeat,
            "SYS_STATUS": lambda _: health.sys_status(),
            "ATTITUDE": self._attitude,
            "LOCAL_POSITION_NED": self._local_position,
            "GLOBAL_POSITION_INT": self._global_position,
            "EXTENDED_SYS_STATE": self._extended_sys_state,
            "AUTOPILOT_VERSION": self._autopilot_version,
            "GPS_RAW_INT": self._gps_raw_int,
            "RC_CHANNELS": self._rc_channels,
            "GPS_GLOBAL_ORIGIN": lambda _: mavlink.MAVLink_gps_global_origin_message(
                *self._place(controller.origin_m)
            ),
            "HOME_POSITION": self._home_position,
            "DISTANCE_SENSOR": self._distance_sensor,
            "TERRAIN_REPORT": lambda _: None,
        }
        if controller.firmware.name == "px4":
            self._builders["ESTIMATOR_STATUS"] = lambda s: health.estimator_status(self._boot_us(s))
        else:
            self._builders["EKF_STATUS_REPORT"] = lambda _: health.ekf_status_report()
        if gimbal is not None:
            self._builders |= {
                "GIMBAL_DEVICE_ATTITUDE_STATUS": lambda s: gimbal.attitude_status(self._boot_ms(s)),
                "GIMBAL_MANAGER_INFORMATION": lambda s: gimbal.information(self._boot_ms(s)),
                "GIMBAL_MANAGER_STATUS": lambda s: gimbal.status(self._boot_ms(s)),
            }
        self._names = {getattr(mavlink, f"MAVLINK_MSG_ID_{n}"): n for n in self._builders}
        rates = controller.firmware.message_rates_hz
        now_s = controller.now_s
        self._period_s = {name: 1.0 / rate for name, rate in rates.items()}
        self._due_s = dict.fromkeys(rates, now_s)
        self._next_s = now_s

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """Send a message this often: 0 is the default rate, -1 never; whether it is known."""
        name = self._names.get(message_id)
        if name is None or not math.isfinite(interval_us):
            return False
        if name == "HEARTBEAT" and self._controller.firmware.name == "px4":
            return False  # PX4 keeps 1 Hz
        if interval_us < 0:
            self._due_s.pop(name, None)
            return True
        default_hz = self._controller.firmware.message_rates_hz.get(name, 1.0)
        self._period_s[name] = interval_us / 1e6 if interval_us > 0 else 1.0 / default_hz
        self._due_s[name] = self._next_s = self._controller.now_s
        return True

    def due(self) -> list[Any]:
        """Return the messages whose time has come."""
        now_s = self._controller.now_s
        if self._next_s > now_s + _SLACK_S:
            return []
        names = [name for name, due_s in self._due_s.items() if due_s <= now_s + _SLACK_S]
        for name in names:
            # One that is late is not sent twice to catch up.
            self._due_s[name] = max(self._due_s[name] + self._period_s[name], now_s)
        self._next_s = min(self._due_s.values(), default=math.inf)
        messages = [self._build(name) for name in names if self._is_sent(name, now_s)]
        return [message for message in messages if message is not None]

    def _is_sent(self, name: str, now_s: float) -> bool:
        """Whether a message that is due is sent."""
        if self._faults.telemetry_stopped and name != "HEARTBEAT":
            return False
        if name == "LOCAL_POSITION_NED":
            return not self._faults.position_stopped and now_s >= self._health.settled_s
        return name != "RC_CHANNELS" or bool(self._controller.pulses_us)

    def on_request(self, message_id: int) -> Any | None:
        """Return one message by its number, None if it is not known."""
        name = self._names.get(message_id)
        return None if name is None else self._build(name)

    def _boot_ms(self, state: BodyState) -> int:
        """Return a state's time on the autopilot's clock, as messages carry it."""
        return round(self.since_boot_s(state.time_s) * 1000.0) & 0xFFFFFFFF

    def _boot_us(self, state: BodyState) -> int:
        return 1000 * self._boot_ms(state)

    def since_boot_s(self, time_s: float) -> float:
        """Return a time on the autopilot's clock in seconds."""
        return time_s - self._boot_s + self._faults.clock_jump_s

    def _build(self, name: str) -> Any:
        return self._builders[name](self._controller.vehicle.state)

    def _heartbeat(self, _state: BodyState) -> Any:
        controller = self._controller
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if controller.mode.behaviour is not Behaviour.HOLD:
            flags |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        status = mavlink.MAV_STATE_STANDBY
        if controller.armed:
            flags |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            failsafe = controller.in_failsafe
            status = mavlink.MAV_STATE_CRITICAL if failsafe else mavlink.MAV_STATE_ACTIVE
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR,
            controller.firmware.mav_autopilot,
            flags,
            controller.mode.custom_mode,
            status,
            3,
        )

    def _gps_raw_int(self, state: BodyState) -> Any:
        return self._health.gps_raw_int(self._boot_us(state), self._place(state.position_m))

    def _attitude(self, state: BodyState) -> Any:
        roll, pitch, yaw = self._trembling(state.attitude_rad, _ANGLE_NOISE_RAD)
        rates = self._trembling(state.rates_rad_s, _RATE_NOISE_RAD_S)
        yaw = wrap_angle(yaw + self._faults.yaw_jump_rad)
        numbers: tuple[float, ...] = (roll, pitch, yaw, *rates)
        numbers = self._frozen("ATTITUDE", numbers, self._faults.attitude_frozen)
        if self._faults.attitude_nan:
            numbers = (math.nan,) * 6
        return mavlink.MAVLink_attitude_message(self._boot_ms(state), *numbers)

    def _frozen(self, name: str, numbers: tuple[float, ...], frozen: bool) -> tuple[float, ...]:
        """Return a message's numbers, or while it is frozen the last ones before that."""
        if not frozen or name not in self._last:
            self._last[name] = numbers
        return self._last[name]

    def _trembling(self, numbers: Triple, deviation: float) -> Triple:
        a, b, c = self._rng.normal(0.0, deviation, 3).tolist()
        return numbers[0] + a, numbers[1] + b, numbers[2] + c

    def _local_position(self, state: BodyState) -> Any:
        local_m = [p - o for p, o in zip(state.position_m, self._controller.origin_m, strict=True)]
        local_m[0] += self._faults.position_jump_m
        numbers = (*local_m, *state.velocity_m_s)
        numbers = self._frozen("POSITION", numbers, self._faults.position_frozen)
        if self._faults.position_nan:
            numbers = (math.nan,) * 6
        return mavlink.MAVLink_local_position_ned_message(self._boot_ms(state), *numbers)

    def _global_position(self, state: BodyState) -> Any:
        velocity = (max(-32768, min(32767, round(100.0 * v))) for v in state.velocity_m_s)
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(state),
            *self._place(state.position_m),
            round((self._controller.home_m[2] - state.position_m[2]) * 1000.0),
            *velocity,
            round(math.degrees(state.yaw_rad) % 360.0 * 100.0) % 36000,
        )

    def _home_position(self, state: BodyState) -> Any:
        """Return HOME_POSITION with zeros for the local place, as ArduPilot sent it up to 4.6."""
        upright = (1.0, 0.0, 0.0, 0.0)
        return mavlink.MAVLink_home_position_message(
            *self._place(self._controller.home_m),
            *(0.0, 0.0, 0.0),
            upright,
            *(0.0, 0.0, 0.0),
            self._boot_us(state),
        )

    def _place(self, position_m: Triple) -> tuple[int, int, int]:
        """Return (latitude, longitude, altitude) of a position, metres NED in the world.

        In 1e-7 degrees and in millimetres above mean sea level, as messages carry them.
        """
        latitude, longitude, altitude_m = self._controller.firmware.home
        north, east, down = position_m
        per_metre = math.degrees(1.0 / _EARTH_RADIUS_M)
        shrunk = math.cos(math.radians(latitude))
        latitude, longitude = latitude + north * per_metre, longitude + east * per_metre / shrunk
        return round(latitude * 1e7), round(longitude * 1e7), round((altitude_m - down) * 1000.0)

    def _distance_sensor(self, state: BodyState) -> Any | None:
        """Return what a rangefinder below sees of level ground; None without one."""
        roll, pitch, _ = state.attitude_rad
        level = math.cos(roll) * math.cos(pitch)
        if not self._health.has_rangefinder or level <= 0:
            return None
        distance = min(round(-100.0 * state.position_m[2] / level), _FAR_CM)
        down = mavlink.MAV_SENSOR_ROTATION_PITCH_270
        return mavlink.MAVLink_distance_sensor_message(
            self._boot_ms(state), 20, _FAR_CM, max(distance, 0), 0, 0, down, 255
        )

    def _rc_channels(self, state: BodyState) -> Any:
        pulses = self._controller.pulses_us[:_CHANNELS]
        unused = (_NO_CHANNEL,) * (_CHANNELS - len(pulses))
        return mavlink.MAVLink_rc_channels_message(
            self._boot_ms(state), len(pulses), *pulses, *unused, 200
        )

    def _extended_sys_state(self, _state: BodyState) -> Any:
        special = {
            Behaviour.TAKE_OFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
            Behaviour.LAND: mavlink.MAV_LANDED_STATE_LANDING,
        }
        landed = special.get(self._controller.mode.behaviour, mavlink.MAV_LANDED_STATE_IN_AIR)
        if self._controller.landed:
            landed = mavlink.MAV_LANDED_STATE_ON_GROUND
        return mavlink.MAVLink_extended_sys_state_message(0, landed)

    def _autopilot_version(self, _state: BodyState) -> Any:
        capabilities = (
            mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
            | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        )
        if self._controller.firmware.name == "px4":
            capabilities |= mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        else:
            capabilities |= mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        major, minor, patch = self._controller.firmware.version
        version = major << 24 | minor << 16 | patch << 8 | 255
        return mavlink.MAVLink_autopilot_version_message(
            capabilities, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1
        )
