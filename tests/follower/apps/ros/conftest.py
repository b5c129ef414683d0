"""A vehicle in one process, the follower's node in another, and a test between them."""

import importlib
import math
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
import ros_interfaces
from program import MAIN
from promises import LateS, assert_keeps, assert_releases, is_moving

from follower.simulation.faults.wire_tap import FIRMWARE, FlightEvidence

HELPERS = Path(ros_interfaces.__file__).parent
ROOT = HELPERS.parent.parent
LARGE_IMAGES = ROOT / "configs/ros/large_images.xml"
STILL_M_S = 0.5
_LATE_S = 1.0
"""Half is of the time-outs below, half of messages between three processes."""
FLIGHT = (
    *("--set", "servo.distance_m=14", "--set", "servo.range_from=ground"),
    *("--set", "servo.target_middle_m=0.4", "--set", "servo.elevation_deg=-25"),
    *("--set", "camera.pitch_deg=-14", "--set", "detector=null", "--set", "tracker=correlation"),
    # A shared computer: half a second longer than the defaults.
    *("--set", "supervisor.frame_timeout_s=1.0", "--set", "supervisor.telemetry_timeout_s=1.0"),
    *("--set", "consent.again=mode"),
    *("--skip-preflight", "frame-rate"),
    *("--skip-preflight", "frame-age", "--skip-preflight", "attitude-rate"),
)


@pytest.fixture(scope="session")
def interfaces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return where messages are that no package of PyPI has."""
    pytest.importorskip("rclpy", reason="ROS 2 is not here: pip install -e .[ros]")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a parser that it imports
        importlib.import_module("rosidl_generator_py")
    return ros_interfaces.build(tmp_path_factory.mktemp("ros_interfaces"))


@pytest.fixture
def domain() -> Iterator[int]:
    """Give a domain of ROS that no other test of this computer has."""
    with free_domain() as number:
        yield number


@contextmanager
def free_domain() -> Iterator[int]:
    """Give a domain of ROS that no other rig of this computer has."""
    for number in range(1, 100):
        with socket.socket(socket.AF_UNIX) as claim:
            try:
                claim.bind(f"\0follower-test-ros-domain-{number}")
            except OSError:
                continue
            yield number
            return
    raise AssertionError("no domain is free")


class Rig:
    """Watches and drives the two processes from the test's own."""

    def __init__(self, domain: int, environment: dict[str, str], folder: Path) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self.folder, self._environment = folder, environment
        self._rclpy, self._context = rclpy, rclpy.Context()
        off = SignalHandlerOptions.NO
        rclpy.init(context=self._context, domain_id=domain, signal_handler_options=off)
        self.node = rclpy.create_node("tester", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.far = False
        self.seen: dict[str, list[Any]] = {}
        self._clients: dict[str, Any] = {}
        self._stack = ExitStack()
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def close(self) -> None:
        for process in self.processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self.processes.values():
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()
        self._stack.close()
        self._executor.shutdown()
        self.node.destroy_node()
        self._rclpy.shutdown(context=self._context)

    def start(self, name: str, *arguments: str) -> None:
        log = self._stack.enter_context((self.folder / f"{name}.log").open("wb"))
        self.processes[name] = subprocess.Popen(
            [sys.executable, *arguments], env=self._environment, stdout=log, stderr=log
        )

    def simulator(self, *arguments: str) -> None:
        self.start("simulator", str(HELPERS / "faulty_simulator.py"), *(arguments or ("px4",)))

    def follower(self, *arguments: str) -> None:
        out = ("--out", str(self.folder / "runs"), "--target", "#e0401c")
        self.start("follower", "-c", MAIN, "ros", *FLIGHT, *out, *arguments)

    def begin(self, mode: str, port: int, *arguments: str, flavour: str = "px4") -> None:
        """Start both processes, and activate the node with the vehicle in the pilot's mode."""
        here = f"127.0.0.1:{port}"
        self.own_mode = FIRMWARE[flavour].setpoint_mode
        self.simulator(flavour, *([f"udpout:{here}"] if mode == "direct" else []))
        self.follower("--mode", mode, "--connect", f"udpin:{here}", *arguments)
        assert self.change("configure"), self.log("follower")
        self.activate()

    def activate(self) -> None:
        """Have the node active, and the vehicle in the pilot's mode."""
        self.set("simulator", mode="LOITER")
        self.wait(lambda: self.change("activate"), 200)  # a busy computer's checks may time out

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text()

    def watch(self, kind: type, topic: str, qos: Any = 10) -> None:
        messages = self.seen.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, qos)

    def wait(self, done: Callable[[], object], within_s: float = 60.0) -> None:
        end = time.monotonic() + within_s
        while not done():
            assert time.monotonic() < end, f"{self.state}: {self.log('follower')}"
            assert self.processes["simulator"].poll() is None, self.log("simulator")
            self._executor.spin_once(timeout_sec=0.1)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.1)

    def call(self, kind: type, service: str, request: Any) -> Any:
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        self.wait(client.service_is_ready)
        future = client.call_async(request)
        self.wait(future.done)
        return future.result()

    def change(self, transition: str) -> bool:
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        wanted = Transition(id=getattr(Transition, f"TRANSITION_{transition.upper()}"))
        request = ChangeState.Request(transition=wanted)
        return bool(self.call(ChangeState, "/follower/change_state", request).success)

    def set(self, node: str, **values: Any) -> Any:
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        given = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=given)
        return self.call(SetParameters, f"/{node}/set_parameters", request).results[0]

    @property
    def state(self) -> str:
        messages = self.seen["/diagnostics"]
        return messages[-1].status[0].message if messages else ""

    def wait_for(self, state: str, within_s: float = 60.0) -> None:
        self.wait(lambda: self.state.startswith(state), within_s)

    @property
    def flights(self) -> list[Path]:
        """The recordings, the oldest first."""
        return sorted((self.folder / "runs").glob("fly*"), key=lambda path: path.stat().st_mtime)

    @property
    def speed(self) -> float:
        """Of the vehicle, in m/s."""
        v = self.seen["/truth"][-1].twist.linear
        return math.hypot(v.x, v.y, v.z)

    @property
    def mode(self) -> str:
        """Of the autopilot."""
        return str(self.seen["/truth"][-1].header.frame_id)

    def follow(self) -> None:
        """Have the pilot consent, and wait until it follows and moves; evidence begins here."""
        from std_srvs.srv import Trigger

        if not self.state.startswith("following"):
            self.set("simulator", mode="LOITER")
            self.wait(lambda: self.mode == "LOITER")
            assert self.call(Trigger, "/follower/select", Trigger.Request()).success
            self.wait_for("ready")
            self.set("simulator", mode=self.own_mode)
        self.wait_for("following")
        self.set("simulator", evidence="")
        self.far = not self.far
        assert self.set("follower", servo__distance_m=19.0 if self.far else 12.0).successful
        self.wait(lambda: self.speed > STILL_M_S and any(map(is_moving, self.look().setpoints)))

    def look(self) -> FlightEvidence:
        """Return what the simulator's watcher saw; its time is `time.monotonic`."""
        path = self.folder / "evidence"
        self.set("simulator", evidence=str(path))
        evidence: FlightEvidence = pickle.loads(path.read_bytes())
        return evidence

    def assert_keeps(self, fault: str, from_s: float, late_s: LateS) -> None:
        assert_keeps(self.look, fault, from_s, lambda: _LATE_S + late_s())

    def assert_releases(self, fault: str, from_s: float, late_s: LateS) -> None:
        ended_s = time.monotonic()
        assert_releases(self.look, fault, from_s, lambda: _LATE_S + late_s(), ended_s)

    def assert_holds(self, what: str, how: str, fault: str, late_s: LateS) -> None:
        """Follow, spoil the image or the pose: it does as with a fault of the catalogue."""
        self.follow()
        from_s = time.monotonic()
        self.set("simulator", **{what: how})
        try:
            self.wait(lambda: not self.state.startswith("following"))
            self.assert_keeps(fault, from_s, late_s)
        finally:
            self.set("simulator", **{what: ""})
        self.wait(lambda: self.state.startswith(("following", "released")))


@pytest.fixture(scope="module")
def make_rig(
    interfaces: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[], Any]]:
    with pytest.MonkeyPatch.context() as patch:
        # The test itself speaks with these messages, too.
        for name in ("PYTHONPATH", "LD_LIBRARY_PATH"):
            patch.setenv(name, str(interfaces), prepend=os.pathsep)
        patch.syspath_prepend(interfaces)
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("FASTDDS_DEFAULT_PROFILES_FILE", str(LARGE_IMAGES))

        @contextmanager
        def make() -> Iterator[Rig]:
            from diagnostic_msgs.msg import DiagnosticArray
            from geometry_msgs.msg import TwistStamped

            with free_domain() as domain:
                environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
                rig = Rig(domain, environment, tmp_path_factory.mktemp("rig"))
                rig.watch(DiagnosticArray, "/diagnostics")
                rig.watch(TwistStamped, "/truth")
                rig.watch(TwistStamped, "/follower/setpoint")
                try:
                    yield rig
                finally:
                    rig.close()

        yield make
