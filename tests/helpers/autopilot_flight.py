"""A vehicle flown by the simulated autopilot, and what it is told."""

import math
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower_control.common.transport import MemoryTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState

STEP_REPLAY = Path(__file__).parents[2] / "benchmarks" / "autopilot_steps" / "step_replay.py"
Companion = runpy.run_path(str(STEP_REPLAY))["Companion"]
FLAVOURS = ("px4", "ardupilot")
SETPOINT_MODE = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}
VELOCITY_AND_YAW_RATE = 0x5C7
ACCEPTED, REJECTED, FAILED, UNSUPPORTED = 0, 1, 4, 3
HEADING_DEG = 60.0

Make = Callable[[], Any]


def velocity(
    forward: float = 0.0,
    right: float = 0.0,
    down: float = 0.0,
    yaw_rate: float = 0.0,
    frame: int = 8,
    mask: int = VELOCITY_AND_YAW_RATE,
    system: int = 1,
    component: int = 1,
    yaw: float = 0.0,
) -> Any:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        *(0, system, component, frame, mask),
        *(0.0, 0.0, 0.0),
        *(forward, right, down),
        *(0.0, 0.0, 0.0),
        yaw,
        yaw_rate,
    )


class Flight:
    """An autopilot at a height, and a companion's end of its link, stepped at 50 Hz."""

    def __init__(self, flavour: str, height_m: float = 20.0) -> None:
        ours, theirs = MemoryTransport.pair()
        heading = math.radians(HEADING_DEG)
        start = BodyState(0.0, (0.0, 0.0, -height_m), attitude_rad=(0.0, 0.0, heading))
        self.autopilot = SimAutopilot(flavour, theirs, start)
        self.companion = Companion(ours)
        self.flavour = flavour
        self.now_s = 0.0
        self.heard: list[Any] = []

    def run(self, seconds: float, message: Any = None, every: int = 1) -> None:
        """Fly, and stream a message in every n-th step."""
        for step in range(round(seconds / 0.02)):
            if message is not None and step % every == 0:
                self.companion.send(message)
            self.now_s += 0.02
            self.autopilot.step(self.now_s)
            self.heard += self.companion.hear()

    def engage(self) -> None:
        self.run(0.2, velocity())
        assert self.autopilot.switch_mode(SETPOINT_MODE[self.flavour])
        self.run(0.2, velocity())

    def command(self, number: int, *params: float) -> int:
        """Send a COMMAND_LONG; return the result that is acknowledged."""
        padded = params + (0.0,) * (7 - len(params))
        self.companion.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))
        self.heard.clear()
        self.run(0.1)
        (ack,) = self.of("COMMAND_ACK")
        assert ack.command == number
        return int(ack.result)

    def of(self, name: str) -> list[Any]:
        return [message for message in self.heard if message.get_type() == name]

    @property
    def texts(self) -> list[str]:
        return [message.text for message in self.of("STATUSTEXT")]

    @property
    def speed_m_s(self) -> float:
        north, east, _ = self.autopilot.state.velocity_m_s
        return math.hypot(north, east)

    @property
    def course_deg(self) -> float:
        north, east, _ = self.autopilot.state.velocity_m_s
        return math.degrees(math.atan2(east, north))

    @property
    def yaw_deg(self) -> float:
        return math.degrees(self.autopilot.state.yaw_rad)


def engaged(flavour: str) -> Flight:
    flight = Flight(flavour)
    flight.engage()
    return flight
