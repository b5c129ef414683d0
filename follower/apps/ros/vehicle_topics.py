"""A vehicle's topics as a transport of MAVLink packets, so that the link is the usual one.

What is checked, recorded and replayed of a link is packets. So topics become the packets that an
autopilot would have sent, and what the link sends becomes topics and services: preflight checks,
supervisor, envelope, recording and replay are those of `follower fly`.
"""

import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from nav_msgs.msg import Odometry
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rcl_interfaces.srv import GetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu

from follower.apps.ros.conversion import (
    Triple,
    attitude_of,
    fill_vector,
    set_stamp,
    stamp_s,
    turned_to_world,
)
from follower.apps.ros.io_node import RELIABLE, SENSOR, IoNode, interfaces

VEHICLE, AUTOPILOT = 1, 1
_MOST_WAITING = 2000
_HEARTBEAT_S = 1.0
_SILENT_S = 3.0
_UNHEARD_S, _GIVEN_UP_S = 1.0, 6.0
"""MAVROS itself waits 5 s for the answer to a command."""
_BOOTED_S = 60.0
"""What a link is told of the clock's zero: stamps from before have room."""
_CUSTOM, _ARMED = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mavlink.MAV_MODE_FLAG_SAFETY_ARMED
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_PX4 = mavlink.MAV_AUTOPILOT_PX4
_UNKNOWN_MODE = 0xFFFF
_ESTIMATES = (
    "attitude_status_flag",
    "velocity_horiz_status_flag",
    "velocity_vert_status_flag",
    "pos_horiz_rel_status_flag",
    "pos_horiz_abs_status_flag",
    "pos_vert_abs_status_flag",
    "pos_vert_agl_status_flag",
    "const_pos_mode_status_flag",
    "pred_pos_horiz_rel_status_flag",
    "pred_pos_horiz_abs_status_flag",
    "gps_glitch_status_flag",
    "accel_error_status_flag",
)
"""Of mavros_msgs/EstimatorStatus, in the order of ESTIMATOR_STATUS's bits."""


class VehicleTopics:
    """Attitude and place of a vehicle that others fly: sensor_msgs/Imu and nav_msgs/Odometry.

    A `Transport`. It says by itself that there is a vehicle, disarmed: so nobody can ever steer
    it. Messages whose stamp lies in the future or is older than 5 s are left out: they count as
    missing. So does what is not finite.

    Args:
        io: takes the messages; started afterwards.
        imu: topic of attitude and body rates.
        odometry: topic of position and velocity, and of attitude while no Imu has one.

    Attributes:
        frame_id: of the odometry's position.
        body_frame: of its velocity.
    """

    def __init__(self, io: IoNode, imu: str = "imu", odometry: str = "odometry") -> None:
        self._io = io
        self._codec = mavlink.MAVLink(None, VEHICLE, AUTOPILOT)
        self._reader = mavlink.MAVLink(None)
        self._reader.robust_parsing = True
        self._inbox: deque[bytes] = deque(maxlen=_MOST_WAITING)
        self._putting = threading.Lock()
        self._imu_attitude = False
        self._beat_s = -math.inf
        self.frame_id, self.body_frame = "map", "base_link"
        io.subscribe(Imu, imu, self._take_imu)
        io.subscribe(Odometry, odometry, self._take_odometry)

    def receive(self) -> bytes:
        """Return the packets since the last call."""
        self._beat()
        parts = [self._inbox.popleft() for _ in range(len(self._inbox))]
        return b"".join(parts)

    def send(self, data: bytes) -> None:
        """Do what a packet of the link asks for."""
        for message in self._reader.parse_buffer(data) or ():
            self._obey(message.get_type(), message)

    def close(self) -> None:
        """Forget what has arrived; the node is closed by whoever made it."""
        self._inbox.clear()

    def _beat(self) -> None:
        now_s = self._io.clock.now()
        if now_s - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            self._put_heartbeat(_PX4, mavlink.MAV_TYPE_QUADROTOR, _CUSTOM, _UNKNOWN_MODE)

    def _put_heartbeat(
        self, autopilot: int, kind: int, base: int, mode: int, state: int = 4
    ) -> None:
        self._put(mavlink.MAVLink_heartbeat_message(kind, autopilot, base, mode, state, 3))

    def _obey(self, name: str, message: Any) -> None:
        if name == "TIMESYNC" and message.tc1 == 0:
            ns = round((self._io.clock.now() + _BOOTED_S) * 1e9)
            self._put(mavlink.MAVLink_timesync_message(ns, message.ts1))

    def _put(self, message: Any) -> None:
        with self._putting:
            self._inbox.append(message.pack(self._codec))
            self._codec.seq = (self._codec.seq + 1) % 256

    def _boot_ms(self, header: Any) -> int | None:
        stamped_s = self._io.clock.of_stamp(stamp_s(header.stamp))
        return None if stamped_s is None else max(round((stamped_s + _BOOTED_S) * 1e3), 0)

    def _take_imu(self, m: Any) -> None:
        if m.orientation_covariance[0] != -1.0:  # by which drivers say that they know none
            self._imu_attitude = self._put_attitude(m.header, m.orientation, m.angular_velocity)

    def _put_attitude(self, header: Any, quaternion: Any, rates: Any) -> bool:
        angles, boot_ms = attitude_of(quaternion), self._boot_ms(header)
        if angles is None or boot_ms is None:
            return False
        turn = rates.x, -rates.y, -rates.z
        self._put(mavlink.MAVLink_attitude_message(boot_ms, *angles, *turn))
        return True

    def _take_odometry(self, m: Any) -> None:
        pose, twist, boot_ms = m.pose.pose, m.twist.twist, self._boot_ms(m.header)
        if boot_ms is None or attitude_of(pose.orientation) is None:
            return
        if not self._imu_attitude:
            self._put_attitude(m.header, pose.orientation, twist.angular)
        self.frame_id = m.header.frame_id or self.frame_id
        self.body_frame = m.child_frame_id or self.body_frame
        place: Triple = (pose.position.y, pose.position.x, -pose.position.z)
        velocity = turned_to_world(pose.orientation, twist.linear)
        self._put(mavlink.MAVLink_local_position_ned_message(boot_ms, *place, *velocity))


class MavrosTopics(VehicleTopics):
    """The vehicle behind a MAVROS node: its state comes from there, setpoints go there.

    Commands and questions for parameters go through MAVROS' services. MAVROS' own word
    `connected` is asked for: without it there are no heartbeats and no answers.

    Args:
        io: takes the messages; started afterwards.
        prefix: the namespace of MAVROS.

    Raises:
        SettingsError: MAVROS' messages are not installed.
    """

    def __init__(self, io: IoNode, prefix: str = "mavros") -> None:
        msg, srv = (interfaces("mavros_msgs", kind) for kind in ("msg", "srv"))
        super().__init__(io, f"{prefix}/imu/data", f"{prefix}/local_position/odom")
        self._srv, self._target = srv, msg.PositionTarget
        self._autopilot, self._kind = mavlink.MAV_AUTOPILOT_INVALID, mavlink.MAV_TYPE_GENERIC
        self._heard_s = -math.inf
        self._unanswered_s: float | None = None
        self._waiting: dict[tuple[Any, ...], tuple[float, Any, Any]] = {}
        take: dict[str, tuple[type, Callable[[Any], None], QoSProfile]] = {
            "extended_state": (msg.ExtendedState, self._take_extended, RELIABLE),
            "sys_status": (msg.SysStatus, self._take_sys_status, RELIABLE),
            "estimator_status": (msg.EstimatorStatus, self._take_estimator, RELIABLE),
            "gpsstatus/gps1/raw": (msg.GPSRAW, self._take_gps, SENSOR),
            "altitude": (msg.Altitude, self._take_altitude, SENSOR),
            "rc/in": (msg.RCIn, self._take_rc, RELIABLE),
            "statustext/recv": (msg.StatusText, self._take_text, SENSOR),
            "state": (msg.State, self._take_state, LATCHED),
        }
        for topic, (kind, callback, qos) in take.items():
            io.subscribe(kind, f"{prefix}/{topic}", callback, qos)
        node, name = io.node, io.name_of
        target = name(f"{prefix}/setpoint_raw/local")
        self._setpoints = node.create_publisher(msg.PositionTarget, target, SENSOR)
        self._commands: Any = node.create_client(srv.CommandLong, name(f"{prefix}/cmd/command"))
        self._info: Any = node.create_client(srv.VehicleInfoGet, name(f"{prefix}/vehicle_info_get"))
        parameters = name(f"{prefix}/param/get_parameters")
        self._parameters: Any = node.create_client(GetParameters, parameters)

    def _beat(self) -> None:
        """MAVROS' state comes as the autopilot's heartbeats do."""

    @property
    def _connected(self) -> bool:
        return self._io.clock.now() - self._heard_s < _SILENT_S

    def _take_state(self, m: Any) -> None:
        if not m.connected:
            self._heard_s = -math.inf
            return
        self._heard_s = self._io.clock.now()
        if self._autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            request = self._srv.VehicleInfoGet.Request(get_all=False)
            self._call(self._info, ("info",), request, self._take_info)
            return
        base = _CUSTOM | (_ARMED if m.armed else 0)
        mode = mode_number(self._autopilot, m.mode)
        self._put_heartbeat(self._autopilot, self._kind, base, mode, m.system_status)

    def _take_info(self, answer: Any) -> None:
        for one in answer.vehicles[:1]:
            self._autopilot, self._kind = one.autopilot, one.type
            versions = one.flight_sw_version, one.middleware_sw_version, one.os_sw_version
            rest = one.board_version, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
            self._put(mavlink.MAVLink_autopilot_version_message(one.capabilities, *versions, *rest))

    def _take_extended(self, m: Any) -> None:
        self._put(mavlink.MAVLink_extended_sys_state_message(m.vtol_state, m.landed_state))

    def _take_sys_status(self, m: Any) -> None:
        sensors = m.sensors_present, m.sensors_enabled, m.sensors_health
        power = m.load, m.voltage_battery, m.current_battery, m.battery_remaining
        errors = m.errors_count1, m.errors_count2, m.errors_count3, m.errors_count4
        self._put(
            mavlink.MAVLink_sys_status_message(
                *sensors, *power, m.drop_rate_comm, m.errors_comm, *errors
            )
        )

    def _take_estimator(self, m: Any) -> None:
        flags = sum(1 << bit for bit, name in enumerate(_ESTIMATES) if getattr(m, name))
        ratios = (0.0,) * 8  # MAVROS hands on none
        if self._autopilot == _PX4:
            self._put(mavlink.MAVLink_estimator_status_message(0, flags, *ratios))
        else:
            self._put(mavlink.MAVLink_ekf_status_report_message(flags, *ratios[:5]))

    def _take_gps(self, m: Any) -> None:
        place = m.lat, m.lon, m.alt, m.eph, m.epv, m.vel, m.cog, m.satellites_visible
        self._put(mavlink.MAVLink_gps_raw_int_message(0, m.fix_type, *place))

    def _take_altitude(self, m: Any) -> None:
        boot_ms = self._boot_ms(m.header)
        if boot_ms is not None and math.isfinite(m.amsl) and abs(m.amsl) < 1e5:
            heights = round(m.amsl * 1e3), 0
            rest = 0, 0, 0, 0xFFFF
            self._put(mavlink.MAVLink_global_position_int_message(boot_ms, 0, 0, *heights, *rest))

    def _take_rc(self, m: Any) -> None:
        channels = [*m.channels, *[0xFFFF] * 18][:18]
        count = min(len(m.channels), 18)
        self._put(mavlink.MAVLink_rc_channels_message(0, count, *channels, m.rssi))

    def _take_text(self, m: Any) -> None:
        self._put(mavlink.MAVLink_statustext_message(m.severity, m.text.encode()[:50]))

    def _obey(self, name: str, message: Any) -> None:
        # Our own answer to TIMESYNC must not say that the autopilot hears us when it does not.
        unheard = name == "TIMESYNC" and self._unanswered_for_s > _UNHEARD_S
        if not self._connected or unheard:
            return
        if name == "SET_POSITION_TARGET_LOCAL_NED":
            self._send_target(message)
        elif name == "COMMAND_LONG":
            self._send_command(message)
        elif name == "PARAM_REQUEST_READ":
            self._ask_parameter(message.param_id)
        else:
            super()._obey(name, message)

    def _send_target(self, m: Any) -> None:
        target = self._target()
        set_stamp(target.header.stamp, self._io.clock.ros_s())
        target.coordinate_frame, target.type_mask = m.coordinate_frame, m.type_mask
        fill_vector(target.velocity, m.vx, -m.vy, -m.vz)
        target.yaw_rate = -m.yaw_rate
        self._setpoints.publish(target)

    def _send_command(self, m: Any) -> None:
        parameters = {f"param{n}": float(getattr(m, f"param{n}")) for n in range(1, 8)}
        request = self._srv.CommandLong.Request(
            command=m.command, confirmation=m.confirmation, **parameters
        )

        def acknowledge(answer: Any) -> None:
            if not answer.success and answer.result == mavlink.MAV_RESULT_ACCEPTED:
                return  # MAVROS has waited for an answer in vain
            self._unanswered_s = None
            here = 0, 0, VEHICLE, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
            self._put(mavlink.MAVLink_command_ack_message(m.command, answer.result, *here))

        waits = any(key[0] == "command" for key in list(self._waiting))
        asks_often = m.command == mavlink.MAV_CMD_REQUEST_MESSAGE and m.param1 == 0
        if not (asks_often and waits):  # MAVROS does one at a time: a change of mode comes first
            self._call(self._commands, ("command", m.command, m.param1), request, acknowledge)

    def _ask_parameter(self, name: str) -> None:
        def take(answer: Any) -> None:
            for one in answer.values:
                value = {2: one.integer_value, 3: one.double_value}.get(one.type)
                if value is not None:
                    kind = mavlink.MAV_PARAM_TYPE_REAL32
                    told = name.encode(), float(value), kind, 1, 0
                    self._put(mavlink.MAVLink_param_value_message(*told))

        key = "parameter", name
        self._call(self._parameters, key, GetParameters.Request(names=[name]), take)

    @property
    def _unanswered_for_s(self) -> float:
        since_s = self._unanswered_s
        return 0.0 if since_s is None else self._io.clock.now() - since_s

    def _call(
        self, client: Any, key: tuple[Any, ...], request: Any, take: Callable[[Any], None]
    ) -> None:
        """Call a service, if it is there and does not owe this answer already.

        The answer is taken on the node's thread; one that has not come after 6 s is given up.
        """
        now_s = self._io.clock.now()
        for one, (since_s, asked, future) in list(self._waiting.items()):
            if now_s - since_s > _GIVEN_UP_S:
                self._waiting.pop(one, None)
                asked.remove_pending_request(future)
        if key in self._waiting or not client.service_is_ready():
            return
        if key[0] == "command" and self._unanswered_s is None:
            self._unanswered_s = now_s
        future = client.call_async(request)
        self._waiting[key] = now_s, client, future

        def done(answered: Any) -> None:
            self._waiting.pop(key, None)
            if answered.exception() is None and answered.result() is not None:
                take(answered.result())

        future.add_done_callback(done)


def mode_number(autopilot: int, name: str) -> int:
    """Return an autopilot's `custom_mode` for MAVROS' name of a mode; 0xFFFF for one unknown."""
    if name.startswith("CMODE(") and name[6:-1].isdigit():
        return int(name[6:-1])
    if autopilot == _PX4:
        known = mavutil.px4_map.get(name.removeprefix("AUTO."))
        return _UNKNOWN_MODE if known is None else known[1] << 16 | known[2] << 24
    numbers = {mode: number for number, mode in mavutil.mode_mapping_acm.items()}
    return int(numbers.get(name, _UNKNOWN_MODE))


def mode_name_of(autopilot: int, number: int) -> str:
    """Return MAVROS' name of an autopilot's `custom_mode`; "CMODE(number)" for one unknown."""
    other = f"CMODE({number})"
    if autopilot != _PX4:
        return str(mavutil.mode_mapping_acm.get(number, other))
    main, sub = number >> 16 & 0xFF, number >> 24 & 0xFF
    for name, (_, its_main, its_sub) in mavutil.px4_map.items():
        if (main, sub) == (its_main, its_sub):
            return f"AUTO.{name}" if sub else str(name)
    return other
