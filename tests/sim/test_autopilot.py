"""The simulated autopilot from bytes to motion, in both flavours."""

import math

import pytest

from follower.links.mavlink import MavlinkLink
from follower_control.setpoint import VelocitySetpoint
from follower_control.transport import MemoryTransport
from follower_sim.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState

FLAVOURS = ("px4", "ardupilot")


class Flight:
    """An autopilot and our link, in lockstep at 50 Hz."""

    def __init__(self, flavour: str, height_m: float = 0.0, heading_deg: float = 60.0) -> None:
        ours, theirs = MemoryTransport.pair()
        yaw = math.radians(heading_deg)
        start = BodyState(0.0, (0.0, 0.0, -height_m), attitude_rad=(0.0, 0.0, yaw))
        self.autopilot = SimAutopilot(flavour, theirs, start)
        self.link = MavlinkLink(ours)
        self.now_s = 0.0
        self.run(1.5)

    def run(self, seconds: float, setpoint: VelocitySetpoint | None = None) -> None:
        for _ in range(round(seconds / 0.02)):
            self.now_s += 0.02
            if setpoint is not None:
                self.link.send(setpoint)
            self.autopilot.step(self.now_s)
            self.link.poll(self.now_s)

    def hand_over(self) -> None:
        self.run(0.5, VelocitySetpoint())
        self.link.enter_setpoint_mode()
        self.run(0.5, VelocitySetpoint())


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_it_arms_takes_off_and_stands_at_the_height(flavour: str) -> None:
    flight = Flight(flavour)
    if flavour == "ardupilot":
        flight.link.enter_setpoint_mode()
    flight.run(1.5)
    flight.link.arm()
    flight.run(2.5)
    flight.link.take_off(10.0)
    flight.run(16.0)
    state = flight.autopilot.state
    assert -state.position_m[2] == pytest.approx(10.0, abs=0.3)
    assert math.hypot(*state.velocity_m_s) < 0.1
    assert flight.autopilot.mode == {"px4": "LOITER", "ardupilot": "GUIDED"}[flavour]
    assert flight.link.take_notes() == []


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_forward_follows_the_heading(flavour: str) -> None:
    flight = Flight(flavour, height_m=15.0)
    flight.hand_over()
    flight.run(8.0, VelocitySetpoint(3.0))
    north, east, down = flight.autopilot.state.velocity_m_s
    assert math.hypot(north, east) == pytest.approx(2.8, abs=0.3)
    assert math.degrees(math.atan2(east, north)) == pytest.approx(60.0, abs=2.0)
    assert abs(down) < 0.05
