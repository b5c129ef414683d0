"""The simulator as a process of ROS: a camera's topic, and an autopilot by MAVLink or by MAVROS."""

import argparse
import threading
from collections.abc import Callable
from contextlib import ExitStack, closing
from typing import Any

import cv2
import rclpy
from geometry_msgs.msg import Vector3
from nav_msgs.msg import Odometry
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu

from follower.apps.ros.conversion import (
    fill_attitude,
    fill_image,
    fill_info,
    fill_vector,
    set_stamp,
    turned_to_body,
)
from follower.apps.ros.io_node import NEWEST, RELIABLE, SENSOR, interfaces
from follower.apps.ros.vehicle_topics import LATCHED, mode_name_of
from follower.links.connections import open_connection
from follower.settings.settings import find_scenario
from follower.simulation.components import start_state
from follower.simulation.runners import CameraSource
from follower.ui.terminal.interrupt import stop_signals
from follower_control.common.transport import MemoryTransport, Transport
from follower_sim.autopilot.autopilot import SYSTEM_ID, SimAutopilot
from follower_sim.camera import SimCamera
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.vehicle.vehicle import STEP_S
from follower_sim.world.world import World
from follower_vision.clock import MonotonicClock
from follower_vision.images.frame import Frame

_AIRBORNE_M = 2.0
_SHUTTING_S = 2.0
_RATES_HZ = {
    "ATTITUDE": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "EXTENDED_SYS_STATE": 5.0,
    "SYS_STATUS": 2.0,
    "GPS_RAW_INT": 2.0,
    "ESTIMATOR_STATUS": 2.0,
    "EKF_STATUS_REPORT": 2.0,
    "RC_CHANNELS": 10.0,
    "GLOBAL_POSITION_INT": 2.0,
}


class SimulatedVehicle:
    """A scenario's world, seen by a camera that publishes `image` and `camera_info`.

    Time in the world begins when the vehicle is in the air. The autopilot and ROS are stepped by
    `run`, on its thread; the camera has one of its own.

    Args:
        node: publishes.
        scenario: a file, or a name from `follower scenarios`.
        autopilot_end: the simulated autopilot's transport.
        flavour: "px4" or "ardupilot".
    """

    def __init__(
        self, node: Node, scenario: str, autopilot_end: Transport, flavour: str = "px4"
    ) -> None:
        self.node, self.clock = node, MonotonicClock()
        self.scenario = load_scenario(find_scenario(scenario))
        self.world = World(self.scenario)
        self.world.begins_s = float("inf")
        start, wind = start_state(self.scenario), self.world.wind.velocity_m_s
        self.autopilot = SimAutopilot(flavour, autopilot_end, start, wind)
        self._stop = threading.Event()
        self._images = node.create_publisher(Image, "image", NEWEST)
        self._compressed = node.create_publisher(CompressedImage, "image/compressed", NEWEST)
        self._info = node.create_publisher(CameraInfo, "camera_info", RELIABLE)

    def run(self, step: Callable[[], None] = lambda: None) -> None:
        """Fly in real time until a signal; `step` is called after each of the autopilot's."""
        _ = self.world.ground, self.world.sky, self.world.scenery_batch  # takes seconds
        executor = SingleThreadedExecutor()
        executor.add_node(self.node)
        camera = SimCamera(self.world, self.autopilot.state_at, self.clock.now())
        source = CameraSource(camera, self.clock)
        thread = threading.Thread(target=self._film, args=(source,), daemon=True)
        thread.start()
        try:
            while True:
                self.fly()
                step()
                executor.spin_once(timeout_sec=STEP_S)
        finally:
            source.close()
            self._stop.set()
            thread.join(_SHUTTING_S)

    def fly(self) -> None:
        """Bring the autopilot to the present."""
        now_s = self.clock.now()
        self.autopilot.step(now_s)
        waits = self.world.begins_s == float("inf")
        if waits and -self.autopilot.state.position_m[2] > _AIRBORNE_M:
            self.world.begins_s = now_s

    def stamp(self, header: Any, age_s: float = 0.0, frame_id: str = "camera") -> None:
        """Stamp a header with ROS's time, less an age."""
        header.frame_id = frame_id
        set_stamp(header.stamp, self.node.get_clock().now().nanoseconds * 1e-9 - age_s)

    def show(self, frame: Frame) -> None:
        """Publish a frame of the camera."""
        message = Image()
        self.stamp(message.header, self.clock.now() - frame.captured_s)
        fill_image(message, frame.image)
        self._images.publish(message)
        if self._compressed.get_subscription_count():
            data = cv2.imencode(".jpg", frame.image)[1].tobytes()
            packed = CompressedImage(header=message.header, format="bgr8; jpeg compressed bgr8")
            packed.data = data
            self._compressed.publish(packed)
        if frame.sequence % 10 == 0:
            self._publish_info(message.header)

    def _film(self, source: CameraSource) -> None:
        while not self._stop.is_set():
            frame = source.read()
            if frame is not None:
                self.show(frame)

    def _publish_info(self, header: Any) -> None:
        model = self.scenario.camera.model
        info = CameraInfo(header=header, d=[*model.distortion])
        fill_info(info, model)
        self._info.publish(info)


class SimulatedMavros:
    """What MAVROS publishes and serves of an autopilot, as far as the follower and a pilot need.

    Args:
        node: publishes and serves, below `mavros`.
        transport: MAVROS' end of MAVLink.
        vehicle: the autopilot's.
    """

    def __init__(self, node: Node, transport: Transport, vehicle: SimulatedVehicle) -> None:
        msg, srv = (interfaces("mavros_msgs", kind) for kind in ("msg", "srv"))
        self._msg, self._transport, self._vehicle = msg, transport, vehicle
        self._codec = mavlink.MAVLink(None, SYSTEM_ID, mavlink.MAV_COMP_ID_UDP_BRIDGE)
        self._beat: Any = None
        self._version: Any = None
        self._angles: Any = None
        self._acks: dict[int, int] = {}
        self._values: dict[str, float] = {}
        kinds: dict[str, tuple[type, Any]] = {
            "state": (msg.State, LATCHED),
            "extended_state": (msg.ExtendedState, RELIABLE),
            "sys_status": (msg.SysStatus, RELIABLE),
            "estimator_status": (msg.EstimatorStatus, RELIABLE),
            "gpsstatus/gps1/raw": (msg.GPSRAW, SENSOR),
            "altitude": (msg.Altitude, SENSOR),
            "rc/in": (msg.RCIn, RELIABLE),
            "imu/data": (Imu, SENSOR),
            "local_position/odom": (Odometry, SENSOR),
        }
        self._kinds = {topic: kind for topic, (kind, _) in kinds.items()}
        self._publishers = {
            topic: node.create_publisher(kind, f"mavros/{topic}", qos)
            for topic, (kind, qos) in kinds.items()
        }
        node.create_subscription(
            msg.PositionTarget, "mavros/setpoint_raw/local", self._take_target, SENSOR
        )
        node.create_service(srv.CommandLong, "mavros/cmd/command", self._serve_command)
        node.create_service(srv.VehicleInfoGet, "mavros/vehicle_info_get", self._serve_info)
        node.create_service(GetParameters, "mavros/param/get_parameters", self._serve_parameters)
        for name, rate_hz in _RATES_HZ.items():
            number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
            self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)
        version = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        self._command(mavlink.MAV_CMD_REQUEST_MESSAGE, version)

    def step(self) -> None:
        """Publish what the autopilot has sent."""
        for message in self._codec.parse_buffer(self._transport.receive()) or ():
            take = getattr(self, f"_on_{message.get_type().lower()}", None)
            if take is not None:
                take(message)

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message of the vehicle; tests spoil it here."""
        self._publishers[topic].publish(message)

    def _new(self, topic: str) -> Any:
        message = self._kinds[topic]()
        self._vehicle.stamp(message.header, frame_id="map")
        return message

    def _send(self, message: Any) -> None:
        self._transport.send(message.pack(self._codec))

    def _command(self, command: int, *params: float) -> None:
        seven = (*params, *(0.0,) * 7)[:7]
        self._send(mavlink.MAVLink_command_long_message(SYSTEM_ID, 1, command, 0, *seven))

    def _on_heartbeat(self, m: Any) -> None:
        self._beat = m
        state = self._new("state")
        state.connected, state.system_status = True, m.system_status
        state.armed = bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        state.mode = mode_name_of(m.autopilot, m.custom_mode)
        self.publish("state", state)

    def _on_autopilot_version(self, m: Any) -> None:
        self._version = m

    def _on_command_ack(self, m: Any) -> None:
        self._acks[m.command] = m.result

    def _on_param_value(self, m: Any) -> None:
        self._values[m.param_id] = m.param_value

    def _on_attitude(self, m: Any) -> None:
        self._angles = m
        imu = self._new("imu/data")
        fill_attitude(imu.orientation, (m.roll, m.pitch, m.yaw))
        fill_vector(imu.angular_velocity, m.rollspeed, -m.pitchspeed, -m.yawspeed)
        self.publish("imu/data", imu)

    def _on_local_position_ned(self, m: Any) -> None:
        if self._angles is None:
            return
        odom = self._new("local_position/odom")
        odom.child_frame_id = "base_link"
        pose, twist, a = odom.pose.pose, odom.twist.twist, self._angles
        fill_attitude(pose.orientation, (a.roll, a.pitch, a.yaw))
        fill_vector(pose.position, m.y, m.x, -m.z)
        body = Vector3()
        fill_vector(body, *turned_to_body(pose.orientation, (m.vx, m.vy, m.vz)))
        twist.linear = body
        self.publish("local_position/odom", odom)

    def _on_extended_sys_state(self, m: Any) -> None:
        state = self._new("extended_state")
        state.vtol_state, state.landed_state = m.vtol_state, m.landed_state
        self.publish("extended_state", state)

    def _on_sys_status(self, m: Any) -> None:
        status = self._new("sys_status")
        status.sensors_present = m.onboard_control_sensors_present
        status.sensors_enabled = m.onboard_control_sensors_enabled
        status.sensors_health = m.onboard_control_sensors_health
        status.battery_remaining = m.battery_remaining
        self.publish("sys_status", status)

    def _on_estimator_status(self, m: Any) -> None:
        status = self._new("estimator_status")
        flags = [name for name in status.get_fields_and_field_types() if name.endswith("_flag")]
        for bit, name in enumerate(flags):
            setattr(status, name, bool(m.flags >> bit & 1))
        self.publish("estimator_status", status)

    def _on_gps_raw_int(self, m: Any) -> None:
        gps = self._new("gpsstatus/gps1/raw")
        gps.fix_type, gps.eph, gps.epv = m.fix_type, m.eph, m.epv
        gps.satellites_visible = m.satellites_visible
        self.publish("gpsstatus/gps1/raw", gps)

    def _on_global_position_int(self, m: Any) -> None:
        altitude = self._new("altitude")
        altitude.amsl, altitude.relative = m.alt * 1e-3, m.relative_alt * 1e-3
        self.publish("altitude", altitude)

    def _on_rc_channels(self, m: Any) -> None:
        rc = self._new("rc/in")
        rc.channels = [getattr(m, f"chan{n}_raw") for n in range(1, m.chancount + 1)]
        self.publish("rc/in", rc)

    def _take_target(self, m: Any) -> None:
        v = m.velocity  # forward, left, up, as MAVROS takes it in a body's frame
        self._send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                *(0, SYSTEM_ID, 1, m.coordinate_frame, m.type_mask),
                *(0.0, 0.0, 0.0, v.x, -v.y, -v.z, 0.0, 0.0, 0.0, 0.0, -m.yaw_rate),
            )
        )

    def _answered(self, known: dict[Any, Any], key: Any) -> Any:
        """Fly until the autopilot has answered."""
        self._vehicle.fly()
        self.step()
        return known.pop(key, None)

    def _serve_command(self, request: Any, response: Any) -> Any:
        self._command(request.command, *(getattr(request, f"param{n}") for n in range(1, 8)))
        result = self._answered(self._acks, request.command)
        response.success = result == mavlink.MAV_RESULT_ACCEPTED
        response.result = mavlink.MAV_RESULT_FAILED if result is None else result
        return response

    def _serve_info(self, _request: Any, response: Any) -> Any:
        if self._beat is not None and self._version is not None:
            info = self._msg.VehicleInfo(autopilot=self._beat.autopilot, type=self._beat.type)
            info.flight_sw_version = self._version.flight_sw_version
            response.success, response.vehicles = True, [info]
        return response

    def _serve_parameters(self, request: Any, response: Any) -> Any:
        for name in request.names:
            message = mavlink.MAVLink_param_request_read_message
            self._send(message(SYSTEM_ID, 1, name.encode(), -1))
            value = self._answered(self._values, name)
            missing, known = ParameterValue(), ParameterValue(type=3, double_value=value or 0.0)
            response.values.append(missing if value is None else known)
        return response


def main(arguments: list[str] | None = None) -> None:
    """Be the process: `python -m follower.apps.ros.simulator SCENARIO --mode mavros|direct`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenario")
    parser.add_argument("--mode", default="direct")
    parser.add_argument("--autopilot", default="px4")
    parser.add_argument("--connect", default="udpout:127.0.0.1:14540")
    options = parser.parse_args(arguments)
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("simulator")
    with ExitStack() as stack:
        ours, end = MemoryTransport.pair()
        theirs: Transport = end
        if options.mode != "mavros":
            theirs = stack.enter_context(closing(open_connection(options.connect)))
        vehicle = SimulatedVehicle(node, options.scenario, theirs, options.autopilot)
        bridge = SimulatedMavros(node, ours, vehicle) if options.mode == "mavros" else None
        try:
            with stop_signals():
                vehicle.run(bridge.step if bridge is not None else lambda: None)
        except KeyboardInterrupt:
            pass


if __name__ == "__main__":
    main()
