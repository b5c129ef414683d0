"""The gimbal and what is below the vehicle, over MAVLink: found, taken, turned, heard."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.links.mavsdk_link import MavsdkLink
from follower.links.pymavlink_link import MavlinkLink
from follower.links.vehicle_monitor import clearance_by_rangefinder, gimbal_of
from follower.settings.link import LinkSettings
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.gimbal import GimbalRates
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.vehicle.gimbal import Gimbal, GimbalModel
from follower_vision.clock import MonotonicClock

STEP_S = 0.02


class Bench:
    """The link and a simulated autopilot in the air, with a gimbal."""

    def __init__(self, flavour: str = "px4", model: GimbalModel | None = None) -> None:
        ours, theirs = MemoryTransport.pair()
        start = BodyState(0.0, (0.0, 0.0, -10.0), attitude_rad=(0.0, 0.0, 0.5))
        gimbal = Gimbal(model or GimbalModel(), -0.4, 0.5, 0.0)
        self.autopilot = SimAutopilot(flavour, theirs, start, gimbal=gimbal)
        self.link = MavlinkLink(ours, LinkSettings(listen_s=0.0))
        self.link.use_gimbal(0)
        self.now_s = 0.0

    def run(self, seconds: float, rates: GimbalRates | None = None) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.autopilot.step(self.now_s)
            self.link.poll(self.now_s)
            if rates is not None:
                self.link.turn_gimbal(rates)

    def looks(self) -> tuple[float, float]:
        """Pitch and yaw of the camera, in truth."""
        _, pitch, yaw = self.autopilot.gimbal.state.attitude_rad
        return pitch, yaw


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_it_is_found_taken_turned_and_heard(flavour: str) -> None:
    bench = Bench(flavour)
    bench.run(2.0)
    bench.run(1.0, GimbalRates(-0.2, 0.3))
    pitch, yaw = bench.looks()
    assert pitch == pytest.approx(-0.6, abs=0.03)
    assert yaw == pytest.approx(0.8, abs=0.04)
    told = bench.link.state.gimbal
    assert told.is_level
    assert told.from_north
    assert told.attitude.pitch_rad == pytest.approx(pitch, abs=0.02)
    assert told.attitude.yaw_rad == pytest.approx(yaw, abs=0.02)
    assert abs(bench.now_s - told.time_s) < 0.06


def test_it_stops_at_its_ends_and_turns_no_faster_than_it_can() -> None:
    bench = Bench(model=GimbalModel(max_rate_deg_s=30, lowest_deg=-45, widest_deg=40))
    bench.run(2.0)
    bench.run(1.0, GimbalRates(0.0, 2.0))
    assert bench.looks()[1] == pytest.approx(0.5 + math.radians(29), abs=0.05)
    bench.run(3.0, GimbalRates(-2.0, 2.0))
    assert bench.looks() == pytest.approx((math.radians(-45), 0.5 + math.radians(40)), abs=1e-6)


def test_whoever_takes_it_from_us_keeps_it() -> None:
    bench = Bench()
    bench.run(2.0)
    bench.autopilot._gimbal.holder = (255, 190)
    bench.run(1.5)
    before, obeyed = bench.looks(), bench.autopilot._gimbal
    bench.autopilot._handlers["GIMBAL_MANAGER_SET_ATTITUDE"] = lambda _: pytest.fail("sent")
    bench.run(1.0, GimbalRates(0.3, 0.3))
    assert bench.looks() == before
    assert obeyed.holder == (255, 190)


def test_rangefinder_and_origin_are_heard() -> None:
    bench = Bench()
    bench.run(3.0)
    assert bench.link.state.clearance is None
    assert bench.link.state.origin is not None
    assert bench.link.state.origin.latitude_deg == pytest.approx(47.397742, abs=1e-6)
    bench.autopilot.health.has_rangefinder = True
    bench.run(1.0)
    assert bench.link.state.clearance.height_m == pytest.approx(10.0, abs=0.1)


def test_home_is_heard_and_stays_where_it_was_while_the_vehicle_flies() -> None:
    bench = Bench()
    bench.autopilot.move_home(0.0, 30.0, -4.0)
    bench.run(4.0)
    for _ in range(2):
        position = bench.link.state.position
        assert position.home_m == pytest.approx((0.0, 30.0, -4.0), abs=0.1)
        assert position.height_m == pytest.approx(-position.down_m - 4.0, abs=0.01)
        bench.autopilot.move_home(0.0, 0.0, -9.0)
        bench.run(3.0)


def distance(**others: int) -> mavlink.MAVLink_distance_sensor_message:
    fields = {"min_distance": 20, "max_distance": 4000, "current_distance": 500} | others
    return mavlink.MAVLink_distance_sensor_message(
        0,
        fields["min_distance"],
        fields["max_distance"],
        fields["current_distance"],
        0,
        0,
        fields.get("orientation", mavlink.MAV_SENSOR_ROTATION_PITCH_270),
        255,
        signal_quality=fields.get("signal_quality", 0),
    )


@pytest.mark.parametrize(
    "unfit",
    [
        {"orientation": 0},
        {"current_distance": 4000},
        {"current_distance": 10},
        {"signal_quality": 1},
    ],
)
def test_a_rangefinder_that_sees_no_ground_says_nothing(unfit: dict[str, int]) -> None:
    assert clearance_by_rangefinder(distance(), 1.0).height_m == 5.0
    assert clearance_by_rangefinder(distance(**unfit), 1.0) is None


@given(
    q=st.lists(st.floats(width=32), min_size=4, max_size=4),
    rates=st.lists(st.floats(width=32), min_size=3, max_size=3),
    flags=st.integers(0, 0xFFFF),
)
def test_any_numbers_in_a_gimbal_s_attitude_are_survived(q, rates, flags) -> None:
    message = mavlink.MAVLink_gimbal_device_attitude_status_message(0, 0, 0, flags, q, *rates, 0)
    gimbal = gimbal_of(message, 1.0)
    assert gimbal is None or gimbal.is_finite


@pytest.mark.slow
def test_through_mavsdk_too() -> None:
    """In real time, because mavsdk has threads and a clock of its own."""
    clock, (ours, theirs) = MonotonicClock(), MemoryTransport.pair()
    gimbal = Gimbal(GimbalModel(), -0.4, 0.5, 0.0)
    start = BodyState(0.0, (0.0, 0.0, -10.0), attitude_rad=(0.0, 0.0, 0.5))
    autopilot = SimAutopilot("px4", theirs, start, gimbal=gimbal)
    autopilot.health.has_rangefinder = True
    link = MavsdkLink(ours, LinkSettings(kind="mavsdk", listen_s=0.0), None, clock)
    link.use_gimbal(0)
    while clock.now() < 30.0 and abs(gimbal.state.attitude_rad[1] + 0.4) < 0.05:
        autopilot.step(clock.now())
        link.poll(clock.now())
        link.turn_gimbal(GimbalRates(-0.2, 0.0))
        clock.sleep_until(clock.now() + 0.01)
    state = link.state
    link.close()
    assert gimbal.state.attitude_rad[1] < -0.44
    assert state.gimbal.is_level
    assert state.gimbal.from_north
    assert state.clearance.height_m == pytest.approx(10.0, abs=0.1)
