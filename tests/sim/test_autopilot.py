"""The simulated autopilot from bytes to motion, in both flavours."""

import math
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower_control.common.transport import MemoryTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState, Triple

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


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize(
    ("asked", "course_deg"),
    [
        ((3.0, 0.0), HEADING_DEG),
        ((-3.0, 0.0), HEADING_DEG - 180.0),
        ((0.0, 3.0), HEADING_DEG + 90.0),
        ((0.0, -3.0), HEADING_DEG - 90.0),
    ],
)
def test_body_velocities_follow_the_heading(
    flavour: str, asked: tuple[float, float], course_deg: float
) -> None:
    flight = engaged(flavour)
    flight.run(6.0, velocity(*asked))
    assert flight.speed_m_s == pytest.approx(2.8, abs=0.25)
    assert flight.course_deg == pytest.approx(course_deg, abs=1.5)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_down_is_positive_and_changes_nothing_else(flavour: str) -> None:
    for sign in (1.0, -1.0):
        flight = engaged(flavour)
        flight.run(4.0, velocity(down=sign))
        assert flight.autopilot.state.velocity_m_s[2] == pytest.approx(sign, rel=0.2)
        assert flight.speed_m_s < 0.01
        assert flight.yaw_deg == pytest.approx(HEADING_DEG, abs=0.5)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_positive_yaw_rate_turns_clockwise(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(3.0, velocity(yaw_rate=math.radians(30.0)))
    assert flight.yaw_deg == pytest.approx(HEADING_DEG + 81.0, abs=6.0)
    assert math.degrees(flight.autopilot.state.rates_rad_s[2]) == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_it_pitches_down_to_go_forward_and_rolls_right_to_go_right(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(0.7, velocity(3.0, 3.0))
    roll, pitch, _ = flight.autopilot.state.attitude_rad
    assert math.degrees(pitch) < -5.0
    assert math.degrees(roll) > 5.0


@pytest.mark.parametrize(
    ("flavour", "frame", "course_deg"),
    [
        ("ardupilot", 1, 0.0),
        ("ardupilot", 7, 0.0),
        ("ardupilot", 8, HEADING_DEG),
        ("ardupilot", 9, HEADING_DEG),
        ("px4", 1, 0.0),
        ("px4", 8, HEADING_DEG),
    ],
)
def test_frames_that_fly(flavour: str, frame: int, course_deg: float) -> None:
    flight = engaged(flavour)
    flight.run(6.0, velocity(3.0, frame=frame))
    assert flight.speed_m_s > 2.5
    assert flight.course_deg == pytest.approx(course_deg, abs=1.5)


@pytest.mark.parametrize("frame", [7, 9, 12])
def test_px4_answers_other_frames_with_a_complaint_each_and_then_its_failsafe(frame: int) -> None:
    flight = engaged("px4")
    flight.run(2.0, velocity(3.0, frame=frame))
    assert flight.texts.count(
        f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"[:50]
    ) == pytest.approx(100, abs=1)
    assert "Failsafe activated" in flight.texts
    assert flight.autopilot.mode == "RTL"


def test_without_yaw_ardupilot_spins_in_a_sideways_command_and_px4_keeps_its_heading() -> None:
    spinning, holding = engaged("ardupilot"), engaged("px4")
    for flight in (spinning, holding):
        flight.run(4.0, velocity(0.0, 3.0, mask=0xDC7))
    assert math.degrees(spinning.autopilot.state.rates_rad_s[2]) == pytest.approx(60.0, abs=8.0)
    assert holding.yaw_deg == pytest.approx(HEADING_DEG, abs=2.0)


def test_with_yaw_ardupilot_spins_in_a_body_frame_and_px4_turns_there() -> None:
    spinning, turning = engaged("ardupilot"), engaged("px4")
    for flight in (spinning, turning):
        flight.run(6.0, velocity(0.0, mask=0x9C7, yaw=math.radians(100.0)))
    assert math.degrees(spinning.autopilot.state.rates_rad_s[2]) == pytest.approx(60.0, abs=8.0)
    assert turning.yaw_deg == pytest.approx(100.0, abs=2.0)


@pytest.mark.slow
def test_ignoring_the_vertical_velocity_stops_ardupilot_and_fails_px4_safe() -> None:
    ardupilot, px4 = engaged("ardupilot"), engaged("px4")
    for flight in (ardupilot, px4):
        flight.run(5.0, velocity(3.0))
        flight.run(5.0, velocity(3.0, mask=VELOCITY_AND_YAW_RATE | 0x20))
    assert ardupilot.speed_m_s < 0.15
    assert ardupilot.autopilot.mode == "GUIDED"
    assert px4.autopilot.mode == "RTL"


def test_mask_0_flies_on_with_ardupilot_and_home_with_px4() -> None:
    ardupilot, px4 = engaged("ardupilot"), engaged("px4")
    for flight in (ardupilot, px4):
        flight.run(8.0, velocity(3.0, frame=1))
        flight.run(8.0, velocity(3.0, frame=1, mask=0))
    assert ardupilot.autopilot.state.velocity_m_s[0] == pytest.approx(2.9, abs=0.2)
    assert px4.autopilot.state.position_m[2] > -12.0


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_velocities_that_are_not_finite_stop_it(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(4.0, velocity(3.0))
    flight.run(8.0, velocity(math.nan))
    assert flight.speed_m_s < 0.4
    assert flight.autopilot.mode == SETPOINT_MODE[flavour]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flavour", "horizontal", "up", "down", "yaw_deg_s"),
    [("ardupilot", 10.2, 4.9, 5.2, 60.0), ("px4", 9.8, 2.9, 1.5, 193.0)],
)
def test_what_is_too_fast_is_clipped_as_recorded(
    flavour: str, horizontal: float, up: float, down: float, yaw_deg_s: float
) -> None:
    asked = [velocity(20.0), velocity(down=-5.0), velocity(down=5.0), velocity(yaw_rate=3.5)]
    flights = [Flight(flavour, height_m=60.0) for _ in asked]
    for flight, message in zip(flights, asked, strict=True):
        flight.engage()
        flight.run(9.0, message)
    fast, climbing, sinking, turning = flights
    assert fast.speed_m_s == pytest.approx(horizontal, rel=0.05)
    assert -climbing.autopilot.state.velocity_m_s[2] == pytest.approx(up, rel=0.15)
    assert sinking.autopilot.state.velocity_m_s[2] == pytest.approx(down, rel=0.15)
    rate = math.degrees(turning.autopilot.state.rates_rad_s[2])
    assert rate == pytest.approx(yaw_deg_s, rel=0.05)


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize(
    ("system", "component", "obeyed"),
    [(1, 1, True), (1, 0, True), (0, 0, True), (2, 1, False), (1, 190, False), (255, 0, False)],
)
def test_addresses(flavour: str, system: int, component: int, obeyed: bool) -> None:
    flight = engaged(flavour)
    flight.run(1.0, velocity(3.0, system=system, component=component))
    assert (flight.speed_m_s > 1.0) is obeyed
    assert flight.texts == []


@pytest.mark.slow
def test_ardupilot_flies_on_for_three_seconds_and_stops_after_11_8_m() -> None:
    flight = engaged("ardupilot")
    flight.run(8.0, velocity(3.0))
    start = flight.autopilot.state.position_m
    flight.run(2.9)
    assert flight.speed_m_s == pytest.approx(3.0, abs=0.1)
    flight.run(2.1)
    assert flight.speed_m_s < 0.25
    assert math.dist(start, flight.autopilot.state.position_m) == pytest.approx(11.8, rel=0.05)
    assert (flight.autopilot.mode, flight.texts) == ("GUIDED", [])
    flight.run(3.0, velocity(3.0))
    assert flight.speed_m_s > 2.5


def test_ardupilots_timeout_is_a_parameter() -> None:
    flight = engaged("ardupilot")
    flight.companion.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 0.5, 9))
    flight.run(8.0, velocity(3.0))
    start = flight.autopilot.state.position_m
    flight.run(3.0)
    assert flight.of("PARAM_VALUE")[0].param_value == 0.5
    assert math.dist(start, flight.autopilot.state.position_m) == pytest.approx(4.4, rel=0.05)


def test_px4_returns_home_after_a_second_and_comes_back_with_the_stream() -> None:
    flight = engaged("px4")
    flight.run(8.0, velocity(3.0))
    speed = flight.speed_m_s
    flight.run(0.98)
    assert flight.autopilot.mode == "OFFBOARD"
    lost_s = 0.98
    while flight.speed_m_s > 0.9 * speed:
        flight.run(0.02)
        lost_s += 0.02
    assert lost_s == pytest.approx(1.68, rel=0.1)
    assert (flight.autopilot.mode, flight.texts) == ("RTL", ["Failsafe activated"])
    flight.run(1.0, velocity(3.0))
    assert flight.autopilot.mode == "OFFBOARD"


def test_px4_does_not_come_back_once_the_pilot_has_chosen_a_mode() -> None:
    flight = engaged("px4")
    flight.run(3.0)
    assert flight.autopilot.mode == "RTL"
    flight.autopilot.switch_mode("POSCTL")
    flight.run(2.0, velocity(3.0))
    assert flight.autopilot.mode == "POSCTL"
    assert flight.speed_m_s < 0.3


@pytest.mark.parametrize(
    ("flavour", "rate_hz", "stays"),
    [("px4", 10, True), ("px4", 1, True), ("px4", 0.5, False), ("ardupilot", 0.5, True)],
)
def test_slow_streams(flavour: str, rate_hz: float, stays: bool) -> None:
    flight = engaged(flavour)
    flight.run(12.0, velocity(2.0), every=round(50 / rate_hz))
    assert (flight.autopilot.mode == SETPOINT_MODE[flavour]) is stays
    if stays:
        assert flight.speed_m_s == pytest.approx(1.9, abs=0.2)


def test_px4_refuses_offboard_without_a_stream_and_ardupilot_takes_guided() -> None:
    px4, ardupilot = Flight("px4"), Flight("ardupilot")
    assert px4.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0) == REJECTED
    assert px4.autopilot.mode == "LOITER"
    assert len(px4.texts) == 1
    assert ardupilot.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == ACCEPTED
    assert ardupilot.autopilot.mode == "GUIDED"


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_the_pilots_mode_ends_the_obedience(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(4.0, velocity(3.0))
    flight.autopilot.switch_mode("LOITER")
    flight.run(8.0, velocity(3.0))
    assert flight.speed_m_s < 0.4
    assert flight.autopilot.mode == "LOITER"
    flight.autopilot.switch_mode(SETPOINT_MODE[flavour])
    flight.run(4.0, velocity(3.0))
    assert flight.speed_m_s > 2.0


@pytest.mark.slow
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_it_arms_takes_off_lands_and_disarms(flavour: str) -> None:
    flight = Flight(flavour, height_m=0.0)
    above = 488.0 if flavour == "px4" else 0.0
    assert not flight.autopilot.armed
    if flavour == "ardupilot":
        assert flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, *(0,) * 6, 10.0) == FAILED
        assert flight.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == ACCEPTED
    assert flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == ACCEPTED
    assert flight.command(mavlink.MAV_CMD_NAV_TAKEOFF, *(0,) * 6, above + 10.0) == ACCEPTED
    flight.run(16.0)
    assert -flight.autopilot.state.position_m[2] == pytest.approx(10.0, abs=0.3)
    assert flight.autopilot.mode == {"px4": "LOITER", "ardupilot": "GUIDED"}[flavour]
    assert flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) in (REJECTED, FAILED)
    assert flight.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    flight.run(30.0)
    assert flight.autopilot.landed
    assert not flight.autopilot.armed
    assert flight.of("EXTENDED_SYS_STATE")[-1].landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_it_disarms_by_itself_when_nothing_follows(flavour: str) -> None:
    flight = Flight(flavour, height_m=0.0)
    flight.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    flight.run(9.0)
    assert flight.autopilot.armed
    flight.run(2.0)
    assert not flight.autopilot.armed


@pytest.mark.slow
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_return_ends_on_the_ground_at_the_start(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(8.0, velocity(4.0))
    assert flight.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    flight.run(120.0)
    north, east, _ = flight.autopilot.state.position_m
    assert math.hypot(north, east) < 2.0
    assert not flight.autopilot.armed


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_commands_that_are_not_known_are_refused(flavour: str) -> None:
    flight = Flight(flavour)
    assert flight.command(mavlink.MAV_CMD_DO_REPOSITION) == UNSUPPORTED
    assert flight.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 99.0) in (REJECTED, FAILED)
    assert flight.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0) == ACCEPTED
    assert len(flight.of("AUTOPILOT_VERSION")) == 1
    assert flight.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 9999.0) == UNSUPPORTED


def test_heartbeats_carry_the_true_modes() -> None:
    px4, ardupilot = engaged("px4"), engaged("ardupilot")
    for flight in (px4, ardupilot):
        flight.run(1.5, velocity())
    beat = px4.of("HEARTBEAT")[-1]
    assert (beat.autopilot, beat.custom_mode, beat.type) == (12, 6 << 16, 2)
    assert beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    beat = ardupilot.of("HEARTBEAT")[-1]
    assert (beat.autopilot, beat.custom_mode) == (3, 4)
    px4.autopilot.switch_mode("LOITER")
    px4.run(1.5)
    assert px4.of("HEARTBEAT")[-1].custom_mode == 4 << 16 | 3 << 24


@pytest.mark.slow
@pytest.mark.parametrize(("flavour", "attitude_hz"), [("px4", 100), ("ardupilot", 50)])
def test_rates(flavour: str, attitude_hz: int) -> None:
    flight = Flight(flavour)
    flight.run(4.0)
    assert len(flight.of("HEARTBEAT")) in (4, 5)
    assert len(flight.of("ATTITUDE")) == pytest.approx(4 * attitude_hz, abs=2)
    command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    assert flight.command(command, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 20000) == ACCEPTED
    assert flight.command(command, mavlink.MAVLINK_MSG_ID_ATTITUDE, -1) == ACCEPTED
    assert flight.command(command, 9999, 1000) == FAILED
    flight.heard.clear()
    flight.run(4.0)
    assert len(flight.of("LOCAL_POSITION_NED")) == pytest.approx(200, abs=2)
    assert flight.of("ATTITUDE") == []


def test_telemetry_is_the_truth_at_its_own_boot_time() -> None:
    flight = engaged("px4")
    flight.run(3.0, velocity(3.0, yaw_rate=0.3))
    message = flight.of("ATTITUDE")[-1]
    offset_s = message.time_boot_ms / 1000.0 - flight.now_s
    assert offset_s > 5.0  # the autopilot's clock is not the companion's
    early = flight.of("ATTITUDE")[-50]
    state = flight.autopilot.state_at(early.time_boot_ms / 1000.0 - offset_s)
    assert (early.roll, early.pitch, early.yaw) == pytest.approx(state.attitude_rad, abs=1e-3)


def test_global_position_is_the_local_one_on_the_earth() -> None:
    flight = engaged("px4")
    flight.run(6.0, velocity(3.0))
    north, east, down = flight.autopilot.state.position_m
    flight.run(0.1)
    message = flight.of("GLOBAL_POSITION_INT")[-1]
    assert (message.lat / 1e7 - 47.397742) * 111319.5 == pytest.approx(north, abs=0.5)
    assert message.alt / 1000.0 == pytest.approx(488.0 - down, abs=0.1)
    assert east > 0


def test_timesync_and_parameters_are_answered() -> None:
    flight = Flight("ardupilot")
    flight.companion.send(mavlink.MAVLink_timesync_message(0, 1234))
    flight.companion.send(mavlink.MAVLink_param_request_read_message(1, 1, b"GUID_TIMEOUT", -1))
    flight.run(0.1)
    (answer,) = flight.of("TIMESYNC")
    assert answer.ts1 == 1234
    assert answer.tc1 > 0
    (parameter,) = flight.of("PARAM_VALUE")
    assert (parameter.param_id, parameter.param_value) == ("GUID_TIMEOUT", 3.0)


def test_faults() -> None:
    flight = engaged("px4")
    faults = flight.autopilot.faults
    faults.telemetry_stopped = True
    flight.heard.clear()
    flight.run(2.0, velocity(1.0))
    assert {m.get_type() for m in flight.heard} == {"HEARTBEAT"}
    faults.telemetry_stopped, faults.silent = False, True
    flight.heard.clear()
    flight.run(2.0, velocity(1.0))
    assert flight.heard == []
    assert flight.speed_m_s > 0.5
    faults.silent, faults.attitude_frozen = False, True
    flight.run(1.0, velocity(yaw_rate=0.5))
    assert len({m.yaw for m in flight.of("ATTITUDE")}) == 1
    faults.attitude_frozen, faults.attitude_nan = False, True
    flight.heard.clear()
    flight.run(0.5, velocity())
    assert all(math.isnan(m.yaw) for m in flight.of("ATTITUDE"))
    faults.attitude_nan, faults.deaf = False, True
    flight.run(2.0, velocity())
    assert flight.autopilot.mode == "RTL"


@pytest.mark.slow
def test_lost_packets_are_a_share_and_the_same_ones_each_time() -> None:
    counts = []
    for _ in range(2):
        ours, theirs = MemoryTransport.pair()
        start = BodyState(0.0, (0.0, 0.0, -10.0))
        autopilot = SimAutopilot("px4", theirs, start, rng=np.random.default_rng(7))
        autopilot.faults.drop_sent = 0.3
        autopilot.step(20.0)
        counts.append([m.get_type() for m in Companion(ours).hear()])
    assert counts[0] == counts[1]
    assert counts[0].count("ATTITUDE") == pytest.approx(1400, rel=0.05)


def _wind(time_s: float) -> Triple:
    return 3.0 + math.sin(time_s), -2.0, 0.3 * math.cos(time_s)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_two_runs_say_the_same_bytes(flavour: str) -> None:
    said = []
    for _ in range(2):
        ours, theirs = MemoryTransport.pair()
        start = BodyState(0.0, (1.0, 2.0, -10.0))
        autopilot = SimAutopilot(flavour, theirs, start, wind=_wind)
        companion = Companion(ours)
        data = b""
        for step in range(200):
            companion.send(velocity(2.0, 1.0, -0.5, 0.2))
            if step == 20:
                autopilot.switch_mode(SETPOINT_MODE[flavour])
            autopilot.step(0.02 * step)
            data += ours.receive()
        said.append(data)
    assert said[0] == said[1]
    assert len(said[0]) > 10000


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_the_size_of_the_callers_steps_does_not_matter(flavour: str) -> None:
    positions = []
    for size in (0.005, 0.02):
        _, theirs = MemoryTransport.pair()
        autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, -10.0)), wind=_wind)
        for step in range(round(4.0 / size)):
            autopilot.step((step + 1) * size)
        positions.append(autopilot.state)
    assert positions[0] == positions[1]


def test_an_unknown_flavour_or_mode_is_refused_by_name() -> None:
    _, theirs = MemoryTransport.pair()
    with pytest.raises(ValueError, match="no autopilot 'inav'; there are px4 and ardupilot"):
        SimAutopilot("inav", theirs, BodyState(0.0, (0.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match="no mode 'AUTO'; there are STABILIZE"):
        Flight("ardupilot").autopilot.switch_mode("AUTO")


def _is_sane(autopilot: SimAutopilot) -> bool:
    state = autopilot.state
    numbers = [*state.position_m, *state.velocity_m_s, *state.attitude_rad, *state.rates_rad_s]
    return all(map(math.isfinite, numbers)) and math.hypot(*state.velocity_m_s) < 60.0


@pytest.mark.slow
@settings(max_examples=60)
@given(st.sampled_from(FLAVOURS), st.lists(st.binary(max_size=300), max_size=8))
def test_arbitrary_bytes_do_no_harm(flavour: str, packets: list[bytes]) -> None:
    ours, theirs = MemoryTransport.pair()
    autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, -10.0)))
    for number, packet in enumerate(packets):
        ours.send(packet)
        autopilot.step(0.02 * number)
    autopilot.step(0.5)
    assert _is_sane(autopilot)


any_float = st.floats(width=32)
byte = st.integers(0, 255)
messages = st.one_of(
    st.builds(
        lambda command, params: mavlink.MAVLink_command_long_message(1, 1, command, 0, *params),
        st.sampled_from([16, 20, 21, 22, 176, 400, 511, 512, 520, 4000]),
        st.lists(any_float, min_size=7, max_size=7),
    ),
    st.builds(
        lambda command, params, place: mavlink.MAVLink_command_int_message(
            *(1, 1, 0, command, 0, 0, *params, *place, params[0])
        ),
        st.sampled_from([22, 176, 400, 511]),
        st.lists(any_float, min_size=4, max_size=4),
        st.lists(st.integers(-(2**31), 2**31 - 1), min_size=2, max_size=2),
    ),
    st.builds(
        lambda frame, mask, numbers: mavlink.MAVLink_set_position_target_local_ned_message(
            *(0, 1, 1, frame, mask, *numbers)
        ),
        st.sampled_from([1, 7, 8, 9, 12]),
        st.one_of(st.sampled_from([0x5C7, 0xDC7, 0x9C7, 0, 0xDF8]), st.integers(0, 0xFFFF)),
        st.lists(any_float, min_size=11, max_size=11),
    ),
    st.builds(
        lambda b, c: mavlink.MAVLink_set_mode_message(1, b, c), byte, st.integers(0, 2**32 - 1)
    ),
    st.builds(
        lambda name, value: mavlink.MAVLink_param_set_message(1, 1, name, value, 9),
        st.one_of(st.binary(max_size=16), st.sampled_from([b"GUID_TIMEOUT", b"COM_OF_LOSS_T"])),
        any_float,
    ),
    st.builds(
        lambda name, index: mavlink.MAVLink_param_request_read_message(1, 1, name, index),
        st.binary(max_size=16),
        st.integers(-(2**15), 2**15 - 1),
    ),
    st.builds(mavlink.MAVLink_timesync_message, st.sampled_from([0, 1]), st.integers(0, 2**62)),
)


@pytest.mark.slow
@settings(max_examples=80)
@given(st.sampled_from(FLAVOURS), st.floats(0.0, 20.0), st.lists(messages, max_size=12))
def test_arbitrary_messages_do_no_harm(flavour: str, height: float, sent: list[Any]) -> None:
    flight = Flight(flavour, height)
    flight.autopilot.switch_mode(SETPOINT_MODE[flavour])
    for message in sent:
        flight.companion.send(message)
        flight.run(0.1)
    flight.run(0.5)
    assert _is_sane(flight.autopilot)
