"""A node's thread that takes messages, and its end."""

import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")

import rclpy
from std_msgs.msg import String

from follower.apps.ros.io_node import IoNode


@pytest.mark.usefixtures("interfaces")
def test_it_closes_while_a_message_is_being_taken(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error of the thread's fails this, as any that nobody catches."""
    rclpy.init(domain_id=domain)
    owner = SimpleNamespace(
        get_parameter=lambda _: SimpleNamespace(value=False),
        get_namespace=lambda: "/",
        resolve_topic_name=lambda topic: f"/{topic}",
    )
    io, taken, takes = IoNode("taker", owner), [], threading.Event()
    io.subscribe(String, "words", taken.append)
    take = io._executor._take_subscription

    def slowly(subscription):
        takes.set()
        time.sleep(0.3)
        return take(subscription)

    monkeypatch.setattr(io._executor, "_take_subscription", slowly)
    io.start()
    publisher = io.node.create_publisher(String, "/words", 10)
    while not takes.wait(0.1):
        publisher.publish(String(data="a word"))
    io.close()
    rclpy.shutdown()
    assert not io._thread.is_alive()
    assert taken
