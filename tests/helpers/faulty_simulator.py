"""The simulator over ROS, whose messages a test spoils by parameters.

`faulty_simulator.py AUTOPILOT [CONNECT]`: with a simulated MAVROS, or MAVLink at CONNECT.

Parameters: `image` and `pose`: "", "missing", "ahead" or "back" (of their stamps; pose by MAVROS
alone), and `pose` also "attitude nan" or "position nan"; `info`: "" or "nan"; `mode`: the pilot's,
tried until it is entered; `clock`: "" for none, "running", "standing" or "back", from where it runs
on, and all stamps are of it; `evidence`: a file into which what a watcher saw is pickled at once,
"" begins it anew. The vehicle's motion is told on `truth`, with the mode as frame. It hovers in the
air from the beginning, and the target stands still.
"""

import pickle
import sys
import time
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import rclpy
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo

from follower.apps.ros import simulator
from follower.apps.ros.conversion import fill_vector, set_stamp, stamp_s
from follower.links.connections import open_connection
from follower.simulation.components import start_state
from follower.simulation.faults.wire_tap import FlightEvidence, WireTap
from follower.ui.terminal.interrupt import stop_signals
from follower_control.common.transport import MemoryTransport
from follower_sim.scenario.scenario_file import load_scenario

JUMPS_S = {"ahead": 1000.0, "back": -1000.0}
CLOCK_START_S, CLOCK_BACK_S = 100.0, 50.0
HEIGHT_M = 9.0


class Mavros(simulator.SimulatedMavros):
    def publish(self, topic, message):
        if topic in ("imu/data", "local_position/odom"):
            fault = self._vehicle.node.get_parameter("pose").value
            jumped_s = stamp_s(message.header.stamp) + JUMPS_S.get(fault, 0.0)
            set_stamp(message.header.stamp, jumped_s)
        super().publish(topic, message)


class Computer:
    """The computer's own monotonic time, which the test has, too."""

    now = staticmethod(time.monotonic)


class Vehicle(simulator.SimulatedVehicle):
    def __init__(self, node, scenario, end, flavour):
        self.tap = WireTap(end, Computer)
        super().__init__(node, scenario, self.tap, flavour)
        self.watched = FlightEvidence(flavour)
        self.wanted, self.clock_is = "", ""
        self.ros_s, self.looked_s = CLOCK_START_S, self.clock.now()
        self.ticks = node.create_publisher(Clock, "/clock", 1)
        self.truth = node.create_publisher(TwistStamped, "truth", 1)
        node.add_on_set_parameters_callback(self.on_parameters)

    def on_parameters(self, parameters):
        for path in (one.value for one in parameters if one.name == "evidence"):
            evidence = replace(self.watched, setpoints=[], mode_heartbeats=[])
            evidence.read(self.tap.received, self.tap.sent)
            if path:
                Path(path).write_bytes(pickle.dumps(evidence))
            else:
                self.watched.motion, self.tap.received, self.tap.sent = [], [], []
        return SetParametersResult(successful=True)

    def stamp(self, header, age_s=0.0, frame_id="camera"):
        super().stamp(header, age_s, frame_id)
        if self.clock_is:
            set_stamp(header.stamp, self.ros_s - age_s)
        if frame_id == "camera":
            fault = self.node.get_parameter("image").value
            set_stamp(header.stamp, stamp_s(header.stamp) + JUMPS_S.get(fault, 0.0))

    def fly(self):
        self.autopilot.step(self.clock.now())  # the world's time does not begin: the car stands
        self.watched.watch(self.autopilot, Computer.now())

    def step(self):
        mode = self.node.get_parameter("mode").value
        if mode != self.wanted and self.autopilot.switch_mode(mode):
            self.wanted = mode
        pose, faults = self.node.get_parameter("pose").value, self.autopilot.faults
        faults.telemetry_stopped = pose == "missing"
        faults.attitude_nan = pose == "attitude nan"
        faults.position_nan = pose == "position nan"
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
    for name in ("image", "pose", "info", "mode", "clock", "evidence"):
        node.declare_parameter(name, "")
    autopilot, *connect = sys.argv[1:]
    with ExitStack() as stack:
        ours, theirs = MemoryTransport.pair()
        if connect:
            theirs = stack.enter_context(closing(open_connection(*connect)))
        vehicle = Vehicle(node, "winding", theirs, autopilot)
        mavros = None if connect else Mavros(node, ours, vehicle)

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
