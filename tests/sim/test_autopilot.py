"""The simulated autopilot from bytes to motion, in both flavours."""

import math
from typing import Any

import pytest
from autopilot_flight import (
    ACCEPTED,
    FAILED,
    FLAVOURS,
    REJECTED,
    SETPOINT_MODE,
    UNSUPPORTED,
    Companion,
    Flight,
    engaged,
    velocity,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower_control.common.transport import MemoryTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState, Triple


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
