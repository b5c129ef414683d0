"""What the simulated autopilot tells about itself, and how often."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower_sim.angles import wrap
from follower_sim.faults import Faults
from follower_sim.flight_controller import FlightController
from follower_sim.flight_modes import Behaviour
from follower_sim.gimbal_protocol import GimbalProtocol
from follower_sim.health import Health
from follower_sim.kinematics import BodyState, Triple

_EARTH_RADIUS_M = 6378137.0
_SLACK_S = 1e-9
_FAR_CM = 4000
_CHANNELS, _NO_CHANNEL = 18, 65535
_ANGLE_NOISE_RAD, _RATE_NOISE_RAD_S = 2e-4, 2e-3
"""What an estimator's attitude trembles by: a living one never says the same twice."""


class Telemetry:
    """Builds messages and knows when each is due.

    Args:
        controller: whose state is told.
        faults: what to falsify.
        health: what to say about sensors, battery, GPS and estimator.
        boot_s: the simulation's time at which the autopilot's own clock was 0.
        rng: makes the attitude's noise.
        gimbal: is told about, if there is one.
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
        self._frozen = _Frozen()
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
        }
        if controller.firmware.name == "px4":
            self._builders["ESTIMATOR_STATUS"] = self._estimator_status
        else:
            self._builders["EKF_STATUS_REPORT"] = lambda _: health.ekf_status_report()
        self._builders |= {
            "GPS_GLOBAL_ORIGIN": self._gps_global_origin,
            "DISTANCE_SENSOR": self._distance_sensor,
            "TERRAIN_REPORT": lambda _: None,
            **self._gimbal_builders(gimbal),
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
        messages = [self._build(name) for name in names if self._is_told(name, now_s)]
        return [message for message in messages if message is not None]

    def _is_told(self, name: str, now_s: float) -> bool:
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

    def boot_ms(self, time_s: float) -> int:
        """Return a time on the autopilot's clock, as messages carry it."""
        return round(self.since_boot_s(time_s) * 1000.0) & 0xFFFFFFFF

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
        latitude, longitude, height_m = self._position_deg(state)
        place = latitude, longitude, self._controller.firmware.home[2] + height_m
        return self._health.gps_raw_int(1000 * self.boot_ms(state.time_s), place)

    def _estimator_status(self, state: BodyState) -> Any:
        return self._health.estimator_status(1000 * self.boot_ms(state.time_s))

    def _attitude(self, state: BodyState) -> Any:
        roll, pitch, yaw = self._trembling(state.attitude_rad, _ANGLE_NOISE_RAD)
        rates = self._trembling(state.rates_rad_s, _RATE_NOISE_RAD_S)
        yaw = wrap(yaw + self._faults.yaw_jump_rad)
        numbers: tuple[float, ...] = (roll, pitch, yaw, *rates)
        numbers = self._frozen.of("ATTITUDE", numbers, self._faults.attitude_frozen)
        if self._faults.attitude_nan:
            numbers = (math.nan,) * 6
        return mavlink.MAVLink_attitude_message(self.boot_ms(state.time_s), *numbers)

    def _trembling(self, numbers: Triple, deviation: float) -> Triple:
        a, b, c = self._rng.normal(0.0, deviation, 3).tolist()
        return numbers[0] + a, numbers[1] + b, numbers[2] + c

    def _local_position(self, state: BodyState) -> Any:
        local_m = [p - o for p, o in zip(state.position_m, self._controller.origin_m, strict=True)]
        local_m[0] += self._faults.position_jump_m
        numbers = (*local_m, *state.velocity_m_s)
        numbers = self._frozen.of("POSITION", numbers, self._faults.position_frozen)
        if self._faults.position_nan:
            numbers = (math.nan,) * 6
        return mavlink.MAVLink_local_position_ned_message(self.boot_ms(state.time_s), *numbers)

    def _global_position(self, state: BodyState) -> Any:
        latitude, longitude, height_m = self._position_deg(state)
        north, east, down = (_int16(100.0 * v) for v in state.velocity_m_s)
        return mavlink.MAVLink_global_position_int_message(
            self.boot_ms(state.time_s),
            round(latitude * 1e7),
            round(longitude * 1e7),
            round((self._controller.firmware.home[2] + height_m) * 1000.0),
            round(height_m * 1000.0),
            *(north, east, down),
            round(math.degrees(state.yaw_rad) % 360.0 * 100.0) % 36000,
        )

    def _position_deg(self, state: BodyState) -> tuple[float, float, float]:
        """Return (latitude, longitude, height): home lies at the world's origin."""
        latitude, longitude, _ = self._controller.firmware.home
        north, east, down = state.position_m
        per_metre = math.degrees(1.0 / _EARTH_RADIUS_M)
        shrunk = math.cos(math.radians(latitude))
        return latitude + north * per_metre, longitude + east * per_metre / shrunk, -down

    def _gps_global_origin(self, state: BodyState) -> Any:
        origin = BodyState(state.time_s, self._controller.origin_m)
        latitude, longitude, height_m = self._position_deg(origin)
        altitude = self._controller.firmware.home[2] + height_m
        numbers = round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1000.0)
        return mavlink.MAVLink_gps_global_origin_message(*numbers)

    def _distance_sensor(self, state: BodyState) -> Any | None:
        """Return what a rangefinder below sees of level ground; None without one."""
        roll, pitch, _ = state.attitude_rad
        level = math.cos(roll) * math.cos(pitch)
        if not self._health.has_rangefinder or level <= 0:
            return None
        distance = min(round(-100.0 * state.position_m[2] / level), _FAR_CM)
        down = mavlink.MAV_SENSOR_ROTATION_PITCH_270
        return mavlink.MAVLink_distance_sensor_message(
            self.boot_ms(state.time_s), 20, _FAR_CM, max(distance, 0), 0, 0, down, 255
        )

    def _gimbal_builders(
        self, gimbal: GimbalProtocol | None
    ) -> dict[str, Callable[[BodyState], Any]]:
        if gimbal is None:
            return {}

        def boot_ms(state: BodyState) -> int:
            return self.boot_ms(state.time_s)

        return {
            "GIMBAL_DEVICE_ATTITUDE_STATUS": lambda state: gimbal.attitude_status(boot_ms(state)),
            "GIMBAL_MANAGER_INFORMATION": lambda state: gimbal.information(boot_ms(state)),
            "GIMBAL_MANAGER_STATUS": lambda state: gimbal.status(boot_ms(state)),
        }

    def _rc_channels(self, state: BodyState) -> Any:
        pulses = self._controller.pulses_us[:_CHANNELS]
        unused = (_NO_CHANNEL,) * (_CHANNELS - len(pulses))
        return mavlink.MAVLink_rc_channels_message(
            self.boot_ms(state.time_s), len(pulses), *pulses, *unused, 200
        )

    def _extended_sys_state(self, _state: BodyState) -> Any:
        return mavlink.MAVLink_extended_sys_state_message(0, self._landed_state())

    def _landed_state(self) -> int:
        controller = self._controller
        if controller.landed:
            return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
        special = {
            Behaviour.TAKE_OFF: mavlink.MAV_LANDED_STATE_TAKEOFF,
            Behaviour.LAND: mavlink.MAV_LANDED_STATE_LANDING,
        }
        return int(special.get(controller.mode.behaviour, mavlink.MAV_LANDED_STATE_IN_AIR))

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


class _Frozen:
    """Repeats the last numbers of a message while it is frozen."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, ...]] = {}

    def of(self, name: str, numbers: tuple[float, ...], frozen: bool) -> tuple[float, ...]:
        """Return what the message says: the numbers, or the last ones before it froze."""
        return self._last.setdefault(name, numbers) if frozen else self._kept(name, numbers)

    def _kept(self, name: str, numbers: tuple[float, ...]) -> tuple[float, ...]:
        self._last[name] = numbers
        return numbers


def _int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))
