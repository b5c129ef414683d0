"""The simulator over ROS, whose messages a test spoils by parameters.

`faulty_simulator.py AUTOPILOT [CONNECT]`: with a simulated MAVROS, or MAVLink at CONNECT.

Parameters: `image` and `pose`: "", "missing", "nan" (pose alone), "ahead" or "back" (of their
stamps; pose by MAVROS alone); `info`: "" or "nan"; `mode`: the pilot's; `clock`: "" for none,
"running", "standing" or "back", from where it runs on, and all stamps are of it. What the vehicle
is asked to fly is told on `taken`, its own motion on `truth`, both with the mode as frame. It
hovers in the air from the beginning, and the target stands still.
"""

import sys
from contextlib import ExitStack, closing
from dataclasses import replace

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo

from follower.apps.ros import simulator
from follower.apps.ros.conversion import fill_vector, set_stamp, stamp_s
from follower.links.connections import open_connection
from follower.simulation.components import start_state
from follower.ui.terminal.interrupt import stop_signals
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario_file import load_scenario

JUMPS_S = {"ahead": 1000.0, "back": -1000.0}
CLOCK_START_S, CLOCK_BACK_S = 100.0, 50.0
HEIGHT_M = 9.0


def spoiled(message, fault):
    """Change a message as a fault wants; None is none."""
    if fault == "missing":
        return None
    if fault in JUMPS_S:
        set_stamp(message.header.stamp, stamp_s(message.header.stamp) + JUMPS_S[fault])
    if fault == "nan":
        for field in ("orientation", "angular_velocity"):
            if hasattr(message, field):
                getattr(message, field).x = float("nan")
        if hasattr(message, "pose"):
            message.pose.pose.position.x = float("nan")
    return message


class Mavros(simulator.SimulatedMavros):
    def publish(self, topic, message):
        if topic in ("imu/data", "local_position/odom"):
            message = spoiled(message, self._vehicle.node.get_parameter("pose").value)
        if message is not None:
            super().publish(topic, message)


class Vehicle(simulator.SimulatedVehicle):
    def __init__(self, node, *arguments):
        super().__init__(node, *arguments)
        self.wanted, self.clock_is = "", ""
        self.ros_s, self.looked_s = CLOCK_START_S, self.clock.now()
        self.ticks = node.create_publisher(Clock, "/clock", 1)
        self.taken = node.create_publisher(TwistStamped, "taken", 50)
        self.truth = node.create_publisher(TwistStamped, "truth", 1)
        controller = self.autopilot._controller
        take = controller.take_setpoint

        def told(target):
            take(target)
            self.tell(self.taken, *target.velocity_m_s)

        controller.take_setpoint = told

    def spoil_pose(self):
        """Have `pose` hold for what goes out by MAVLink."""
        send = self.autopilot._link.send

        def sent(message):
            fault = self.node.get_parameter("pose").value
            posed = message.get_type() in ("ATTITUDE", "LOCAL_POSITION_NED")
            if posed and fault == "nan":
                for name in {"roll", "yawspeed", "x", "vx"} & set(message.get_fieldnames()):
                    setattr(message, name, float("nan"))
            if not (posed and fault == "missing"):
                send(message)

        self.autopilot._link.send = sent

    def stamp(self, header, age_s=0.0, frame_id="camera"):
        super().stamp(header, age_s, frame_id)
        if self.clock_is:
            set_stamp(header.stamp, self.ros_s - age_s)
        if frame_id == "camera":
            fault = self.node.get_parameter("image").value
            set_stamp(header.stamp, stamp_s(header.stamp) + JUMPS_S.get(fault, 0.0))

    def fly(self):
        self.autopilot.step(self.clock.now())  # the world's time does not begin: the car stands

    def step(self):
        if self.node.get_parameter("mode").value != self.wanted:
            self.wanted = self.node.get_parameter("mode").value
            self.autopilot.switch_mode(self.wanted)
        self.tick(self.node.get_parameter("clock").value)
        self.tell(self.truth, *self.autopilot.state.velocity_m_s)

    def tick(self, clock_is):
        now_s = self.clock.now()
        if clock_is == "back" != self.clock_is:
            self.ros_s -= CLOCK_BACK_S
        if clock_is != "standing":
            self.ros_s += now_s - self.looked_s
        self.looked_s, self.clock_is = now_s, clock_is
        if clock_is:
            message = Clock()
            set_stamp(message.clock, self.ros_s)
            self.ticks.publish(message)

    def show(self, frame):
        if self.node.get_parameter("image").value != "missing":
            super().show(frame)

    def _publish_info(self, header):
        if self.node.get_parameter("info").value == "nan":
            self._info.publish(CameraInfo(header=header, width=640, k=[float("nan")] * 9))
        else:
            super()._publish_info(header)

    def tell(self, publisher, x, y, z):
        message = TwistStamped()
        self.stamp(message.header, frame_id=self.autopilot.mode)
        fill_vector(message.twist.linear, x, y, z)
        publisher.publish(message)


def in_the_air(scenario):
    state = start_state(scenario)
    north, east, _ = state.position_m
    return replace(state, position_m=(north, east, -HEIGHT_M))


def at_15_hz(path):
    return load_scenario(path, ("camera.rate_hz=15",))


def main() -> None:
    simulator.start_state, simulator.load_scenario = in_the_air, at_15_hz
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("simulator")
    for name in ("image", "pose", "info", "mode", "clock"):
        node.declare_parameter(name, "")
    autopilot, *connect = sys.argv[1:]
    with ExitStack() as stack:
        ours, theirs = MemoryTransport.pair()
        if connect:
            theirs = stack.enter_context(closing(open_connection(*connect)))
        vehicle = Vehicle(node, "winding", theirs, autopilot)
        mavros = None if connect else Mavros(node, ours, vehicle)
        if connect:
            vehicle.spoil_pose()

        def step():
            if mavros is not None:
                mavros.step()
            vehicle.step()

        try:
            with stop_signals():
                vehicle.run(step)
        except KeyboardInterrupt:
            pass


if __name__ == "__main__":
    main()
