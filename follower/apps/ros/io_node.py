"""A node that only takes messages in, on a thread of its own, and the clock of its time."""

import contextlib
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data

from follower_vision.clock import MonotonicClock
from follower_vision.sources.frame_source import ClosesItself

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
SENSOR = qos_profile_sensor_data
RELIABLE = QoSProfile(depth=10)
"""As REP 2003 has it: sensors best effort, results reliable."""
_AHEAD_S, _OLD_S = 0.1, 5.0
_TICK_S = 0.002


class RosClock(MonotonicClock):
    """Our clock beside ROS's: the computer's monotonic one, or with `use_sim_time` ROS's own.

    Stamps are turned into our time by their age. It never goes back: when a simulation begins
    anew, time stands still, and what was flown is released for want of anything new.

    Args:
        ros: the node's rclpy clock.
        simulated: take its time.
    """

    def __init__(self, ros: Any, simulated: bool) -> None:
        super().__init__()
        self._ros = ros
        self._simulated = simulated
        self._newest_s = 0.0
        self._start_s: float | None = None

    def ros_s(self) -> float:
        """Return the time on ROS's clock, in seconds."""
        return float(self._ros.now().nanoseconds) * 1e-9

    def now(self) -> float:
        """Return the seconds since the clock was made."""
        if not self._simulated:
            return super().now()
        time_s = self.ros_s()
        if self._start_s is None:
            if time_s == 0.0:
                return 0.0  # no /clock yet
            self._start_s = time_s
        self._newest_s = max(self._newest_s, time_s - self._start_s)
        return self._newest_s

    def sleep_until(self, time_s: float) -> None:
        """Sleep until `time_s`; a simulated time that stands still is waited for."""
        if not self._simulated:
            super().sleep_until(time_s)
            return
        pause = threading.Event()
        while self.now() < time_s and rclpy.ok():
            pause.wait(_TICK_S)

    def of_stamp(self, stamp_s: float) -> float | None:
        """Return a header's stamp on this clock; None if it lies in the future or is old."""
        age_s = self.ros_s() - stamp_s
        if not -_AHEAD_S <= age_s <= _OLD_S:
            return None
        return self.now() - max(age_s, 0.0)


class IoNode(ClosesItself):
    """A plain node whose callbacks run on one thread, whatever the lifecycle node waits for.

    Args:
        name: of the node.
        owner: the lifecycle node: its remapping of topics and its `use_sim_time` hold.
    """

    def __init__(self, name: str, owner: Any) -> None:
        simulated = bool(owner.get_parameter("use_sim_time").value)
        self.node = Node(
            name,
            namespace=owner.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("use_sim_time", value=simulated)],
        )
        self.clock = RosClock(self.node.get_clock(), simulated)
        self._owner = owner
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name=name, daemon=True)

    def name_of(self, topic: str) -> str:
        """Return a topic's or service's full name, as the lifecycle node resolves it."""
        return str(self._owner.resolve_topic_name(topic))

    def subscribe(
        self, kind: type, topic: str, take: Callable[[Any], None], qos: QoSProfile = SENSOR
    ) -> None:
        """Have messages of a topic taken."""
        self.node.create_subscription(kind, self.name_of(topic), self._guarded(take, topic), qos)

    def _guarded(self, take: Callable[[Any], None], topic: str) -> Callable[[Any], None]:
        """Let a message that cannot be taken count as missing: the others still come."""

        def taken(message: Any) -> None:
            try:
                take(message)
            except Exception as error:  # whatever it is, the thread has to live on
                said = f"a message of {topic} is left out: {' '.join(str(error).split())}"
                self.node.get_logger().warning(said, throttle_duration_sec=5.0)

        return taken

    def start(self) -> None:
        """Begin to take messages."""
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self) -> None:
        """Take no more, and destroy the node."""
        self._executor.shutdown()
        if self._thread.is_alive():
            self._thread.join()
        self.node.destroy_node()
