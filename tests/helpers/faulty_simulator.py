"""The simulator over ROS with a simulated MAVROS, whose messages a test spoils by parameters.

Parameters: `image` and `pose`: "", "missing", "nan" (pose alone), "ahead" or "back" (of their
stamps); `mode`: the pilot's. What the vehicle is asked to fly is told on `taken`, its own motion
on `truth`, both with the mode as frame. It hovers in the air from the beginning, and
the target stands still.
"""

import sys
from dataclasses import replace

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from follower.apps.ros import simulator
from follower.apps.ros.conversion import fill_vector, set_stamp, stamp_s
from follower.simulation.components import start_state
from follower.ui.terminal.interrupt import stop_signals
from follower_control.common.transport import MemoryTransport

JUMPS_S = {"ahead": 1000.0, "back": -1000.0}
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
    wanted = ""

    def __init__(self, node, transport, vehicle):
        super().__init__(node, transport, vehicle)
        self.taken = node.create_publisher(TwistStamped, "taken", 50)
        self.truth = node.create_publisher(TwistStamped, "truth", 1)

    def publish(self, topic, message):
        if topic in ("imu/data", "local_position/odom"):
            message = spoiled(message, self._vehicle.node.get_parameter("pose").value)
        if message is not None:
            super().publish(topic, message)

    def _take_target(self, message):
        super()._take_target(message)
        self.tell(self.taken, message.velocity.x, message.velocity.y, message.velocity.z)

    def step(self):
        super().step()
        autopilot, node = self._vehicle.autopilot, self._vehicle.node
        if node.get_parameter("mode").value != self.wanted:
            self.wanted = node.get_parameter("mode").value
            autopilot.switch_mode(self.wanted)
        self.tell(self.truth, *autopilot.state.velocity_m_s)

    def tell(self, publisher, x, y, z):
        message = TwistStamped()
        self._vehicle.stamp(message.header, frame_id=self._vehicle.autopilot.mode)
        fill_vector(message.twist.linear, x, y, z)
        publisher.publish(message)


class Vehicle(simulator.SimulatedVehicle):
    def stamp(self, header, age_s=0.0, frame_id="camera"):
        super().stamp(header, age_s, frame_id)
        if frame_id == "camera":
            fault = self.node.get_parameter("image").value
            set_stamp(header.stamp, stamp_s(header.stamp) + JUMPS_S.get(fault, 0.0))

    def fly(self):
        self.autopilot.step(self.clock.now())  # the world's time does not begin: the car stands

    def show(self, frame):
        if self.node.get_parameter("image").value != "missing":
            super().show(frame)


def in_the_air(scenario):
    state = start_state(scenario)
    north, east, _ = state.position_m
    return replace(state, position_m=(north, east, -HEIGHT_M))


def main() -> None:
    simulator.start_state = in_the_air
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node("simulator")
    for name in ("image", "pose", "mode"):
        node.declare_parameter(name, "")
    ours, theirs = MemoryTransport.pair()
    vehicle = Vehicle(node, "winding", theirs, sys.argv[1])
    mavros = Mavros(node, ours, vehicle)
    try:
        with stop_signals():
            vehicle.run(mavros.step)
    except KeyboardInterrupt:
        pass


if __name__ == "__main__":
    main()
