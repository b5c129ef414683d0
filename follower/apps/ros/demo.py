"""`follower ros-demo`: the simulator and the node as processes, and an operator between them."""

import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import cv2
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from sensor_msgs.msg import Image

from follower.apps.inspect import inspect_recorded
from follower.apps.ros.conversion import image_of
from follower.apps.ros.io_node import NEWEST, RELIABLE, interfaces
from follower.links.connections import ConnectionFailedError
from follower.recording import open_flight
from follower.settings.settings import configs_folder, find_scenario
from follower.simulation.options import simulation_settings
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import stop_signals
from follower_control.common.transport import UdpTransport
from follower_sim.scenario.scenario_file import load_scenario
from follower_vision.clock import MonotonicClock

PICTURE = "overlay.jpg"
_START_S, _FOLLOW_S, _END_S = 120.0, 60.0, 20.0
_LAUNCHER = "from follower.apps.main import main; main()"


class Operator:
    """Drives the node's lifecycle and watches what it publishes.

    Attributes:
        states: of the supervisor, as /diagnostics tells them, each once.
        overlay: a picture that came between two messages that told of following.
        over: the flight is being ended: no picture is taken any more.
    """

    def __init__(self) -> None:
        self._node = Node("operator")
        self._clock = MonotonicClock()
        self._client: Any = self._node.create_client(ChangeState, "/follower/change_state")
        self.states: list[str] = []
        self.overlay: Any = None
        self._newest: Any = None
        self.over = False
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, RELIABLE)
        self._node.create_subscription(Image, "/follower/overlay", self._seen, NEWEST)

    def close(self) -> None:
        """Destroy its node."""
        self._node.destroy_node()

    def change(self, transition: int, within_s: float) -> bool:
        """Ask for a transition of the lifecycle; whether it was made in time."""
        if not self.wait(self._client.service_is_ready, within_s):
            return False
        request = ChangeState.Request(transition=Transition(id=transition))
        future = self._client.call_async(request)
        return self.wait(future.done, within_s) and bool(future.result().success)

    def wait(self, done: Callable[[], bool], within_s: float) -> bool:
        """Take messages until something holds, or for so many seconds; whether it does."""
        until_s = self._clock.now() + within_s
        while not done():
            if self._clock.now() > until_s:
                return False
            rclpy.spin_once(self._node, timeout_sec=0.1)
        return True

    def _diagnosed(self, message: DiagnosticArray) -> None:
        for status in message.status:
            state = status.message.partition(":")[0]
            if state == "following" and self.states[-1:] == [state] and not self.over:
                self.overlay = self._newest or self.overlay
            self._newest = None
            if self.states[-1:] != [state]:
                self.states.append(state)

    def _seen(self, message: Image) -> None:
        self._newest = message


def fly_demo(mode: str, scenario: str, seconds: float, out: Path) -> int:
    """Fly, write report and picture, return the exit code: 0 if the target was followed.

    Args:
        mode: "direct" or "mavros".
        scenario: a file, or a name from `follower scenarios`.
        seconds: how long it follows.
        out: takes the flight's folder.

    Raises:
        SettingsError: mavros_msgs is not installed, and wanted.
        ConnectionFailedError: the node does not answer.
    """
    if mode == "mavros":
        interfaces("mavros_msgs")
    console = Console()
    loaded = load_scenario(find_scenario(scenario))
    out = out / "ros-demo"
    out.mkdir(parents=True, exist_ok=True)
    config = out / "settings.yaml"
    settings = simulation_settings(loaded, None, ("autonomy=full",))
    config.write_text(settings.to_yaml(), "utf-8")
    port = _free_port()
    with _own_domain():
        simulator = ["-m", "follower.apps.ros.simulator", scenario, "--mode", mode]
        node = ["-c", _LAUNCHER, "ros", "--mode", mode, "-c", str(config), "--out", str(out)]
        node += ["--target", loaded.select.colour]
        # What a busy computer makes of the simulated camera refuses no real flight.
        node += ["--skip-preflight", "frame-rate", "--skip-preflight", "frame-age"]
        if mode == "direct":
            simulator += ["--connect", f"udpout:127.0.0.1:{port}"]
            node += ["--connect", f"udpin:127.0.0.1:{port}"]
        with stop_signals(), _process(simulator), _process(node):
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            operator = Operator()
            try:
                _fly(operator, seconds, console)
            finally:
                operator.close()
                rclpy.shutdown()
    return _report(operator, out, console)


def _fly(operator: Operator, seconds: float, console: Console) -> None:
    print_line(console, "Starting the simulator and the node")
    if not operator.change(Transition.TRANSITION_CONFIGURE, _START_S):
        raise ConnectionFailedError("the node cannot be configured; its log says why")
    if not operator.change(Transition.TRANSITION_ACTIVATE, _START_S):
        raise ConnectionFailedError("the node cannot be activated; its log says why")
    print_line(console, "Active: it takes off")
    if operator.wait(lambda: "following" in operator.states, _FOLLOW_S):
        print_line(console, "Following")
        operator.wait(lambda: "released" in operator.states, seconds)
    operator.over = True
    operator.change(Transition.TRANSITION_DEACTIVATE, _END_S)


def _report(operator: Operator, out: Path, console: Console) -> int:
    flights = sorted(out.glob("fly*"), key=lambda folder: folder.stat().st_mtime)
    if flights:
        inspect_recorded(open_flight(flights[-1]), console=console)
    if operator.overlay is not None:
        cv2.imwrite(str(flights[-1] / PICTURE), image_of(operator.overlay))
        print_line(console, f"{flights[-1] / PICTURE}")
    print_line(console, f"States: {', '.join(operator.states)}")
    return 0 if "following" in operator.states else 1


def _free_port() -> int:
    """Return a free UDP port of this computer."""
    with closing(UdpTransport.listen("127.0.0.1", 0)) as listener:
        return listener.port


@contextmanager
def _own_domain() -> Iterator[None]:
    """Keep the demo's topics on this computer, apart from those of other programs, and whole.

    A raw image does not fit into Fast DDS' usual shared memory: few arrive.
    """
    before = dict(os.environ)
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.SystemRandom().randrange(1, 100)))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault(
        "FASTDDS_DEFAULT_PROFILES_FILE", str(configs_folder() / "ros" / "large_images.xml")
    )
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def _process(arguments: list[str]) -> Iterator[None]:
    """Run a program of ours while entered; it is ended politely."""
    with subprocess.Popen([sys.executable, *arguments]) as process:  # noqa: S603  our own
        try:
            yield
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
