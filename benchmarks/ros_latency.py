"""How much later a 720p image becomes a setpoint over ROS than through our own thread.

`python benchmarks/ros_latency.py [SECONDS]` runs both side by side at 30 Hz each, half a period
apart, in one process: frames of a live source on its own thread, and images that another process
publishes. Each is timed from its stamp, just before it is published or handed over, to vision's
thread having it; then the setpoint goes out, as a packet over UDP or as a TwistStamped. Vision and
control between the two are the same code. Medians, and the quarter that went best, for a computer
that does other things too; and how many images were lost on the way.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import command_line
import numpy as np

try:
    import rclpy
    from geometry_msgs.msg import TwistStamped
    from rclpy.lifecycle import LifecycleNode
    from sensor_msgs.msg import Image
except ImportError as error:
    sys.exit(f"ros_latency: {error}; it needs ROS 2, see docs/how-to/ros.md")

from follower.apps.ros.conversion import fill_image, fill_twist, set_stamp
from follower.apps.ros.io_node import NEWEST, SENSOR
from follower.apps.ros.topic_source import TopicSource
from follower_control.common.transport import UdpTransport
from follower_control.vehicle.setpoint import HOLD
from follower_vision.clock import MonotonicClock
from follower_vision.images.frame import Image as Picture
from follower_vision.sources.frame_source import FrameSource
from follower_vision.sources.live_source import LiveSource

PERIOD_S, SHAPE = 1 / 30, (720, 1280, 3)
ROOT = Path(__file__).parents[1]
# Without it Fast DDS loses images of this size.
PROFILE = ROOT / "configs/ros/large_images.xml"


def picture() -> Picture:
    """Return what both see: (720, 1280, 3) of noise."""
    return np.random.default_rng(0).integers(0, 255, SHAPE, np.uint8)


def images_in(seconds: float) -> int:
    """Return how many images the camera's process sends."""
    return round(seconds / PERIOD_S)


def publish(seconds: float) -> None:
    """Be the camera's process."""
    rclpy.init()
    node = rclpy.create_node("camera")
    publisher, message = node.create_publisher(Image, "image", NEWEST), Image()
    fill_image(message, picture())
    for _ in range(images_in(seconds)):
        time.sleep(PERIOD_S)
        set_stamp(message.header.stamp, node.get_clock().now().nanoseconds * 1e-9)
        publisher.publish(message)


class Pictures:
    """A connection that gives the same picture, copied, 30 times a second."""

    rate_hz = 30.0

    def __init__(self, clock: MonotonicClock) -> None:
        self._clock, self._picture = clock, picture()

    def images(self) -> Iterator[tuple[Picture, float]]:
        """Give picture and time, for ever."""
        while True:
            time.sleep(PERIOD_S)
            stamped_s = self._clock.now()
            yield self._picture.copy(), stamped_s

    def close(self) -> None:
        """Hold nothing."""


def measure(seconds: float) -> None:
    """Measure for so many seconds, and print."""
    rclpy.init()
    node = LifecycleNode("follower")
    setpoints = node.create_publisher(TwistStamped, "setpoint", SENSOR)
    sink, speaker = UdpTransport.pair()
    source = TopicSource(node, "image", "raw")
    clock = source.clock
    own = LiveSource(lambda: Pictures(clock), clock)
    delays: dict[str, list[float]] = {"own thread": [], "over ROS": []}

    def watch(name: str, frames: FrameSource) -> None:
        while (frame := frames.read()) is not None:
            if name == "over ROS":
                message = TwistStamped()
                fill_twist(message.twist, HOLD)
                setpoints.publish(message)
            else:
                speaker.send(bytes(60))
            delays[name].append(clock.now() - frame.captured_s)

    threads = [
        threading.Thread(target=watch, args=pair)
        for pair in (("own thread", own), ("over ROS", source))
    ]
    with subprocess.Popen([sys.executable, __file__, str(seconds), "--camera"]) as camera:
        for thread in threads:
            thread.start()
        camera.wait()
    own.close()
    source.close()
    for thread in threads:
        thread.join()
    sink.close()
    speaker.close()
    sent, answered = images_in(seconds), len(delays["over ROS"])
    print(f"over ROS    {answered} of {sent} images were answered, {sent - answered} lost")
    for name, found in delays.items():
        best, middle, worst = (1e3 * np.percentile(found, q) for q in (25, 50, 95))
        print(
            f"{name:11} {len(found):4} images: {middle:5.2f} ms, best quarter {best:5.2f}, "
            f"95 % {worst:5.2f}"
        )
    extra = [
        1e3 * (np.percentile(delays["over ROS"], q) - np.percentile(delays["own thread"], q))
        for q in (50, 25)
    ]
    print(f"ROS adds {extra[0]:.2f} ms (median), {extra[1]:.2f} ms (best quarter)")
    rclpy.shutdown()


def main() -> None:
    """Be one of the two processes."""
    os.environ.setdefault("FASTDDS_DEFAULT_PROFILES_FILE", str(PROFILE))
    parser = command_line.parser(__doc__)
    parser.add_argument("seconds", nargs="?", type=command_line.positive, default=20.0)
    parser.add_argument("--camera", action="store_true", help="be the camera's process")
    options = parser.parse_args()
    (publish if options.camera else measure)(options.seconds)


if __name__ == "__main__":
    command_line.run(main)
