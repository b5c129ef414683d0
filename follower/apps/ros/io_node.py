"""A node that only takes messages in, on a thread of its own, and the clock of its time."""

import contextlib
import importlib
import math
import threading
from collections.abc import Callable
from types import ModuleType
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.task import Future

from follower_control.common.strict_config import SettingsError
from follower_vision.clock import MonotonicClock
from follower_vision.sources.frame_source import ClosesItself

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
SENSOR = qos_profile_sensor_data
RELIABLE = QoSProfile(depth=10)
"""As REP 2003 has it: sensors best effort, results reliable."""
_AHEAD_S, _OLD_S = 0.1, 5.0
_TICK_S = 0.002
_STANDS_S = 0.25
_LOOK_S = 0.05
_SAY_S = 5.0


def interfaces(package: str, kind: str = "msg") -> ModuleType:
    """Import the messages ("msg") or services ("srv") of a package that not everybody has.

    Raises:
        SettingsError: it is not installed; names what is.
    """
    try:
        return importlib.import_module(f"{package}.{kind}")
    except ImportError as error:
        raise SettingsError(
            f"{package} is not here ({error}): apt install "
            f"ros-$ROS_DISTRO-{package.replace('_', '-')}, and source the ROS set-up"
        ) from error


class RosClock(MonotonicClock):
    """Our clock beside ROS's: the computer's monotonic one, or with `use_sim_time` ROS's own.

    Stamps are turned into our time by their age. It never goes back. A simulated time that jumps
    back goes on from where it was; one that stands is carried on after 0.25 s by the computer's
    clock. So what no longer comes grows old, and the flight holds.

    Args:
        ros: the node's rclpy clock.
        simulated: take its time.
    """

    def __init__(self, ros: Any, simulated: bool) -> None:
        super().__init__()
        self._ros = ros
        self._simulated = simulated
        self._lock = threading.Lock()
        self._now_s = 0.0
        # At the last tick: ours, ROS's, the computer's.
        self._tick = (0.0, 0.0, 0.0)

    def ros_s(self) -> float:
        """Return the time on ROS's clock, in seconds."""
        return float(self._ros.now().nanoseconds) * 1e-9

    def now(self) -> float:
        """Return the seconds since the clock was made."""
        if not self._simulated:
            return super().now()
        with self._lock:
            ros_s, computer_s = self.ros_s(), super().now()
            ours_s, ticked_s, since_s = self._tick
            if ticked_s == 0.0:
                reached_s = 0.0  # no /clock yet, or its first tick
            elif ros_s == ticked_s:
                reached_s = ours_s + computer_s - since_s - _STANDS_S
            else:
                reached_s = ours_s + ros_s - ticked_s
            self._now_s = max(self._now_s, reached_s)
            if ros_s != ticked_s:
                self._tick = self._now_s, ros_s, computer_s
            return self._now_s

    def sleep_until(self, time_s: float) -> None:
        """Sleep until `time_s`."""
        if not self._simulated:
            super().sleep_until(time_s)
            return
        pause = threading.Event()
        while self.now() < time_s and rclpy.ok():
            pause.wait(_TICK_S)

    def ticks(self, within_s: float) -> bool:
        """Wait until ROS's time goes on, at most so many seconds; whether it does."""
        pause, last_s = threading.Event(), 0.0
        for _ in range(round(within_s / _LOOK_S)):
            now_s = self.ros_s()
            if last_s not in (0.0, now_s):
                return True
            last_s = now_s
            pause.wait(_LOOK_S)
        return False

    def of_stamp(self, stamp_s: float) -> float | None:
        """Return a header's stamp on this clock; None if it lies in the future or is old."""
        now_s = self.now()
        ours_s, ros_s, _ = self._tick if self._simulated else (now_s, self.ros_s(), 0.0)
        at_s = ours_s + stamp_s - ros_s
        return min(at_s, now_s) if -_OLD_S <= at_s - now_s <= _AHEAD_S else None


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
        self._said_s: dict[str, float] = {}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._ended: Any = Future()
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
                self.left_out(f"a message of {topic}", error)

        return taken

    def left_out(self, what: str, why: Exception) -> None:
        """Say what cannot be taken, each not more often than every 5 s."""
        now_s = self.clock.now()
        if now_s - self._said_s.get(what, -math.inf) >= _SAY_S:
            self._said_s[what] = now_s
            said = f"{what} is left out: {' '.join(str(why).split())}"
            self._owner.get_logger().warning(said)  # its own log has no topic

    def start(self) -> None:
        """Begin to take messages."""
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin_until_future_complete(self._ended)

    def close(self) -> None:
        """Take no more, and destroy the node."""
        # The thread first: what a shutdown destroys it would still use; rclpy's waits for no one.
        self._ended.set_result(None)
        if self._thread.is_alive():
            self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
