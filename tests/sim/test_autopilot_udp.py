"""The simulated autopilot over a real socket, against pymavlink's own client."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest
from pymavlink import mavutil

from follower_control.common.transport import UdpTransport
from follower_sim.autopilot.autopilot import SimAutopilot, autopilot_thread
from follower_sim.kinematics import BodyState
from follower_vision.clock import MonotonicClock

mavlink = mavutil.mavlink
_PATIENCE_S = 20.0


@contextmanager
def _running(flavour: str, port: int) -> Iterator[SimAutopilot]:
    clock = MonotonicClock()
    start = BodyState(clock.now(), (0.0, 0.0, 0.0), attitude_rad=(0.0, 0.0, 1.0))
    with (
        closing(UdpTransport.connect("127.0.0.1", port)) as transport,
        autopilot_thread(SimAutopilot(flavour, transport, start), clock) as autopilot,
    ):
        yield autopilot


class Client:
    """A script as users of pymavlink write it."""

    def __init__(self, port: int) -> None:
        self.link: Any = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", dialect="common")

    def wait_for(self, done: Callable[[], bool]) -> None:
        end_s = time.monotonic() + _PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, "waited in vain"
            self.link.recv_match(blocking=True, timeout=0.05)

    def command(self, number: int, *params: float) -> None:
        padded = params + (0.0,) * (7 - len(params))
        self.link.mav.command_long_send(1, 1, number, 0, *padded)

    def stream(self, forward: float, done: Callable[[], bool]) -> None:
        def send_and_look() -> bool:
            self.link.mav.set_position_target_local_ned_send(
                0, 1, 1, 8, 0x5C7, 0, 0, 0, forward, 0, 0, 0, 0, 0, 0, 0
            )
            return done()

        self.wait_for(send_and_look)


@pytest.mark.slow
@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_a_mavutil_client_arms_takes_off_and_flies(
    flavour: str, free_port: Callable[[], int]
) -> None:
    port = free_port()
    client = Client(port)
    with _running(flavour, port) as autopilot:
        assert client.link.wait_heartbeat(timeout=_PATIENCE_S) is not None
        if flavour == "ardupilot":
            client.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
            client.wait_for(lambda: autopilot.mode == "GUIDED")
        client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        client.wait_for(lambda: bool(client.link.motors_armed()))
        nan = float("nan")
        height = 490.5 if flavour == "px4" else 2.5
        client.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, height)
        client.wait_for(lambda: autopilot.state.position_m[2] < -2.3)
        if flavour == "px4":
            client.stream(0.0, lambda: autopilot.switch_mode("OFFBOARD"))
        client.stream(2.0, lambda: autopilot.state.velocity_m_s[1] > 1.0)
        _, pitch, _ = autopilot.state.attitude_rad
        assert client.link.messages["ATTITUDE"].pitch == pytest.approx(pitch, abs=0.1)
    client.link.close()
