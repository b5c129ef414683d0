"""The gimbal and what is below the vehicle, over MAVLink: found, taken, turned, heard."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.links.gimbal_manager import GimbalManager
from follower.links.mavsdk_link import MavsdkLink
from follower.links.pymavlink_link import MavlinkLink
from follower.links.vehicle_monitor import clearance_by_rangefinder, gimbal_of
from follower.settings.link import LinkSettings
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.gimbal import GimbalHistory, GimbalRates, camera_to_world
from follower_control.vehicle.state import Attitude
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.vehicle.gimbal import Gimbal, GimbalModel
from follower_vision.clock import MonotonicClock
from follower_vision.geometry.line_of_sight import along_camera_axes, rotation

STEP_S = 0.02
_LOCKED = (
    mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
)


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


def test_its_control_is_asked_for_again_after_the_command_was_lost_or_forgotten() -> None:
    bench = Bench()
    send = bench.link._channel.send
    lost: list[bytes] = []

    def lose_the_first(packet: bytes) -> None:
        message = mavlink.MAVLink(None).decode(bytearray(packet))
        command = getattr(message, "command", None)
        if lost or command != mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            send(packet)
        else:
            lost.append(packet)

    bench.link._channel.send = lose_the_first
    bench.run(6.0)
    assert lost
    for turned in (0.3, 0.6):
        bench.run(1.0, GimbalRates(0.0, 0.3))
        assert bench.looks()[1] == pytest.approx(0.5 + turned, abs=0.04)
        bench.run(0.1, GimbalRates())
        bench.autopilot._gimbal.holder = (0, 0)  # restarted
        bench.run(5.0)


@pytest.mark.parametrize(("device", "ours"), [(2, True), (1, False), (0, False)])
def test_whoever_controls_another_gimbal_does_not_stop_ours(device: int, ours: bool) -> None:
    manager = GimbalManager(1, 191, device)
    for number, holder in ((2, (1, 191)), (1, (255, 190))):
        status = mavlink.MAVLink_gimbal_manager_status_message(0, 0, number, *holder, 0, 0)
        assert manager.take("GIMBAL_MANAGER_STATUS", status)
    assert manager.obeys_us is ours


def test_rangefinder_and_origin_are_heard() -> None:
    bench = Bench()
    bench.run(3.0)
    assert bench.link.state.clearance is None
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


def told(pitch_rad: float, yaw_rad: float, flags: int = _LOCKED, number: int = 0) -> Any:
    """A gimbal's attitude as a float32 quaternion, without roll."""
    q = np.array(
        [
            math.cos(yaw_rad / 2) * math.cos(pitch_rad / 2),
            -math.sin(yaw_rad / 2) * math.sin(pitch_rad / 2),
            math.cos(yaw_rad / 2) * math.sin(pitch_rad / 2),
            math.sin(yaw_rad / 2) * math.cos(pitch_rad / 2),
        ],
        np.float32,
    ).tolist()
    return mavlink.MAVLink_gimbal_device_attitude_status_message(
        0, 0, 0, flags, q, 0, 0, 0, 0, gimbal_device_id=number
    )


def turned_by(state: Any, pitch_rad: float, yaw_rad: float) -> float:
    """The angle (deg) between a camera's axes as told and as they are."""
    right = along_camera_axes(rotation(0.0, pitch_rad, yaw_rad))
    found = camera_to_world(state, Attitude(0, 0, 0, 0, 0, 0, 0))
    cosine = (np.trace(right.T @ found) - 1) / 2
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))


@given(
    yaw=st.floats(-3.1, 3.1),
    first=st.floats(-0.003, 0.003),
    second=st.floats(-0.003, 0.003),
    sign=st.sampled_from([-1, 1]),
)
@example(yaw=1.7, first=0.0, second=0.0, sign=-1)
def test_straight_down_and_up_it_looks_where_it_looks_between_two_times_too(
    yaw: float, first: float, second: float, sign: int
) -> None:
    """There roll and yaw flip together from sample to sample, at the slightest tremble."""
    history, straight = GimbalHistory(), sign * math.pi / 2
    for time_s, tremble in ((1.0, first), (1.02, second)):
        state = gimbal_of(told(straight + tremble, yaw), time_s)
        assert turned_by(state, straight + tremble, yaw) < 0.5
        assert history.add(state)
    assert turned_by(history.at(1.01), straight, yaw) < 1.0


@pytest.mark.parametrize(
    ("flags", "is_level", "from_north"),
    [
        (_LOCKED, True, True),
        (mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK, True, False),
        (mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME, False, True),
        (0, False, False),
    ],
)
def test_what_its_angles_are_against_is_told_for_each_axis(
    flags: int, is_level: bool, from_north: bool
) -> None:
    state = gimbal_of(told(-0.3, 0.2, flags), 1.0)
    assert (state.is_level, state.from_north) == (is_level, from_north)


@pytest.mark.parametrize(("device", "heard"), [(0, -0.2), (1, -0.2), (2, -1.2), (154, -0.7)])
def test_of_several_gimbals_the_one_that_is_wanted_is_heard_or_the_first(
    device: int, heard: float
) -> None:
    """Two are the autopilot's, and tell their numbers; two have component numbers of their own."""
    ours, theirs = MemoryTransport.pair()
    link = MavlinkLink(ours, LinkSettings(listen_s=0.0))
    link.use_gimbal(device)

    def say(message: Any, component: int = 1) -> None:
        theirs.send(message.pack(mavlink.MAVLink(None, 1, component)))

    beat = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, mavlink.MAV_STATE_STANDBY, 3
    )
    say(beat)
    link.poll(0.1)
    for step in range(5):
        say(told(-0.2, 0.0, number=1))
        say(told(-1.2, 0.0, number=2))
        say(told(-0.7, 0.0), mavlink.MAV_COMP_ID_GIMBAL)
        say(told(-0.9, 0.0), mavlink.MAV_COMP_ID_GIMBAL2)
        link.poll(0.2 + step * STEP_S)
        assert link.state.gimbal.attitude.pitch_rad == pytest.approx(heard, abs=1e-3)


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
