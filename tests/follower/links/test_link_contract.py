"""The same promises of both links, to both autopilots.

MAVSDK runs by itself: it flies over UDP in real time. The other link flies in memory, on a
simulated clock; `test_links.py` and `follower fly` fly it over UDP.
"""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from link_rig import (
    _BOTH,
    EACH,
    MAVSDK_ONCE,
    SECRET,
    SETPOINT,
    LateS,
    Rig,
    rig,
)
from pymavlink.dialects.v20 import common as mavlink

from follower.links.packet_parser import checksum
from follower.links.status import LinkStatus
from follower.settings.link import LinkKind
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint


@pytest.fixture
def flight(kind: LinkKind, flavour: str) -> Iterator[Rig]:
    """A link that hears its vehicle."""
    with rig(kind, flavour) as flight:
        flight.connect()
        yield flight


@pytest.mark.slow
@EACH
def test_it_arms_takes_off_flies_a_velocity_and_holds(kind: LinkKind, flavour: str) -> None:
    with rig(kind, flavour, height_m=0.0) as flight:
        link, autopilot = flight.link, flight.autopilot
        flight.connect()
        assert link.autopilot_name == flavour
        if flavour == "ardupilot":
            link.enter_setpoint_mode()
            flight.run(lambda: link.state.obeys_setpoints)
        flight.run(lambda: link.altitude_msl_m is not None)
        link.arm()
        flight.run(lambda: link.state.armed)
        link.take_off(4.0)
        flight.run(lambda: autopilot.state.position_m[2] < -3.8)
        if flavour == "px4":
            flight.run(lambda: link.state.mode == "LOITER")
        flight.enter_setpoint_mode()
        flight.run(lambda: autopilot.state.velocity_m_s[0] > 1.0, VelocitySetpoint(2.0))
        assert abs(autopilot.state.velocity_m_s[1]) < 0.1
        flight.run(lambda: autopilot.state.rates_rad_s[2] > 0.2, VelocitySetpoint(0, 0, 0, 0.4))
        link.enter_hold_mode()
        flight.run(lambda: autopilot.mode in ("LOITER", "BRAKE"))
        assert link.state.landed is False


@EACH
def test_what_is_sent_is_frame_8_with_velocity_and_yaw_rate_from_component_191(flight: Rig) -> None:
    flight.run(lambda: len(flight.wire.of(SETPOINT)) > 10, VelocitySetpoint(1, -2, 0.5, 0.25))
    _, sent = flight.wire.of(SETPOINT)[-1]
    assert (sent.coordinate_frame, sent.type_mask) == (8, 0x5C7)
    assert (sent.target_system, sent.target_component) == (1, 1)
    assert (sent.vx, sent.vy, sent.vz) == (1.0, -2.0, 0.5)
    assert sent.yaw_rate == pytest.approx(0.25, abs=1e-6)
    assert (sent.get_srcSystem(), sent.get_srcComponent()) == (1, 191)


@pytest.mark.slow
@MAVSDK_ONCE
def test_it_beats_once_a_second_as_an_onboard_controller(flight: Rig, late_s: LateS) -> None:
    flight.run(for_s=4.0)
    beats = [m for at, m in flight.wire.of(0)][-3:]
    assert {(m.type, m.autopilot, m.get_srcComponent()) for m in beats} == {
        (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 191)
    }
    times = [at for at, _ in flight.wire.of(0)]
    assert 4 <= len(times) <= 7 + late_s()


@pytest.mark.slow
@MAVSDK_ONCE
def test_rates_are_asked_for_and_measured_and_clocks_compared(flight: Rig, late_s: LateS) -> None:
    flight.run(for_s=2.0)

    def as_asked() -> bool:
        rates = flight.link.status(flight.clock.now()).rates
        measured = {rate.name: rate.measured_hz for rate in rates}
        wanted = {"ATTITUDE": 100, "LOCAL_POSITION_NED": 30}
        return all(measured[name] == pytest.approx(hz, rel=0.3) for name, hz in wanted.items())

    flight.run(as_asked)
    status = flight.link.status(flight.clock.now())
    assert status.round_trip_s is not None
    assert status.round_trip_s < 0.2 + late_s()
    assert status.clock_error_s is not None
    assert status.clock_error_s < 0.02 + late_s()
    attitude = flight.link.state.attitude
    assert -0.1 - late_s() < attitude.time_s - flight.clock.now() <= 0.0


@EACH
def test_the_pilots_sticks_and_modes_and_commands_to_us_are_heard(
    kind: LinkKind, flavour: str, late_s: LateS
) -> None:
    with rig(kind, flavour) as flight:
        link, autopilot = flight.link, flight.autopilot
        autopilot.move_sticks(1500, 1400, 1000, 1600)
        flight.connect()
        flight.run(lambda: link.state.rc is not None)
        assert link.state.rc.pulses_us == (1500, 1400, 1000, 1600)
        flight.enter_setpoint_mode()
        flight.run(setpoint=HOLD, for_s=0.3)
        autopilot.switch_mode("POSCTL" if flavour == "px4" else "LOITER")
        switched_s = flight.clock.now()
        flight.run(lambda: not link.state.obeys_setpoints, HOLD)
        # Of itself it tells its mode once a second.
        assert flight.clock.now() - switched_s < 0.4 + late_s()
        order = mavlink.MAVLink_command_long_message(1, 191, mavlink.MAV_CMD_USER_1, 0, 1, *[0] * 6)
        flight._theirs.send(order.pack(mavlink.MAVLink(None, 255, 190)))
        heard: list[Any] = []
        flight.run(lambda: bool(heard.extend(link.take_commands()) or heard))
        assert [(one.command, one.value, one.system) for one in heard] == [(31010, 1.0, 255)]
        link.answer(heard[0], True)
        _, answer = flight.wire.of(mavlink.MAVLINK_MSG_ID_COMMAND_ACK)[-1]
        assert (answer.command, answer.result) == (31010, mavlink.MAV_RESULT_ACCEPTED)
        assert (answer.target_system, answer.target_component) == (255, 190)


@pytest.mark.slow
@MAVSDK_ONCE
def test_an_autopilot_that_was_restarted_is_heard_asked_and_flown_again(flight: Rig) -> None:
    flight.enter_setpoint_mode()
    flight.run(setpoint=VelocitySetpoint(2.0), for_s=1.0)
    flight.cut_power()
    flight.run(for_s=4.5)  # MAVSDK calls a system gone that was silent for 3 s
    assert flight.link.state.heartbeat_age_s(flight.clock.now()) > 3.5
    flight.boot(20.0)
    flight.run(lambda: flight.link.state.attitude_age_s(flight.clock.now()) < 0.1)
    flight.enter_setpoint_mode()
    flight.run(lambda: flight.autopilot.state.velocity_m_s[0] > 1.0, VelocitySetpoint(2.0))

    def status() -> LinkStatus:
        return flight.link.status(flight.clock.now())

    assert status().clock_restarts == 1
    # Rates are those of the last two seconds.
    flight.run(lambda: status().rates[0].measured_hz > 70, HOLD)


@pytest.mark.slow
@MAVSDK_ONCE
def test_when_no_setpoint_is_sent_the_stream_ends_within_a_tenth(
    flight: Rig, late_s: LateS
) -> None:
    flight.enter_setpoint_mode()
    flight.run(setpoint=VelocitySetpoint(2.0), for_s=0.5)
    ended_s = flight.clock.now()
    flight.run(for_s=1.0)
    late = [at - ended_s for at, _ in flight.wire.of(SETPOINT) if at > ended_s]
    assert max(late, default=0.0) < 0.1 + late_s()
    assert flight.autopilot.mode in ("OFFBOARD", "GUIDED")  # nobody asked for another


@pytest.mark.slow
@EACH
def test_a_stalled_loop_sends_no_old_velocity_and_mavsdk_stops_within_0_3_s(
    flight: Rig, kind: LinkKind, flavour: str, late_s: LateS
) -> None:
    flight.enter_setpoint_mode()
    flight.run(lambda: flight.autopilot.state.velocity_m_s[0] > 1.5, VelocitySetpoint(2.0))
    stalled_s = flight.clock.now()
    flight.wait(1.0)
    after = [(at - stalled_s, m) for at, m in flight.wire.of(SETPOINT) if at > stalled_s]
    assert [m.vx for at, m in after if m.vx != 0.0 and at > 0.2 + late_s()] == []
    if kind == "pymavlink":
        assert after == []
        return
    zeros = [at for at, m in after if m.vx == 0.0]
    assert zeros[0] < 0.3 + late_s()
    asked = mavlink.MAVLINK_MSG_ID_COMMAND_LONG
    modes = [at - stalled_s for at, m in flight.wire.of(asked) if m.command == 176]
    assert min(at for at in modes if at > 0) < 0.3 + late_s()
    assert flight.autopilot.mode == {"px4": "LOITER", "ardupilot": "BRAKE"}[flavour]
    assert max(zeros) < 0.45 + late_s()
    flight.run(for_s=0.1)
    assert any("stood still" in note for note in flight.link.take_notes())


@pytest.mark.slow
@MAVSDK_ONCE
def test_a_stall_does_not_take_the_mode_from_a_pilot_who_has_taken_over(flight: Rig) -> None:
    flight.enter_setpoint_mode()
    flight.run(setpoint=VelocitySetpoint(2.0), for_s=0.5)
    flight.autopilot.switch_mode("RTL")
    flight.run(lambda: flight.link.state.mode == "RTL", VelocitySetpoint(2.0))
    flight.run(setpoint=HOLD, for_s=0.1)
    flight.wait(0.8)
    assert flight.autopilot.mode == "RTL"


@pytest.mark.slow
@EACH
def test_a_loop_that_comes_back_from_a_stall_leaves_the_autopilots_own_mode_alone(
    flight: Rig, kind: LinkKind
) -> None:
    if kind != "mavsdk":
        pytest.skip("its stream ends with the loop, and the autopilot's time-out acts")
    flight.enter_setpoint_mode()
    flight.run(lambda: flight.autopilot.state.velocity_m_s[0] > 1.0, VelocitySetpoint(2.0))
    flight.wait(1.6)  # a heartbeat tells of the mode meanwhile
    back_s = flight.clock.now()
    flight.link.poll(back_s)
    flight.link.send(HOLD)
    flight.wait(0.2)
    assert [at for at, _ in flight.wire.of(SETPOINT) if at > back_s] == []
    assert flight.autopilot.mode not in ("OFFBOARD", "GUIDED")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "flavour", "trouble"),
    [
        *[("pymavlink", flavour, trouble) for flavour in _BOTH for trouble in (0.05, 0.3)],
        *[("mavsdk", "px4", 0.3), ("mavsdk", "ardupilot", 0.05)],
    ],
)
def test_loss_doubling_and_reordering_are_survived(
    kind: LinkKind, flavour: str, trouble: float, late_s: LateS
) -> None:
    with rig(kind, flavour, trouble) as flight:
        flight.connect()
        flight.enter_setpoint_mode()
        flight.run(lambda: flight.autopilot.state.velocity_m_s[0] > 1.5, VelocitySetpoint(2.0))
        flight.run(setpoint=VelocitySetpoint(2.0), for_s=1.0)
        status = flight.link.status(flight.clock.now())
        assert status.clock_restarts == 0
        assert status.skipped_bytes == 0
        assert 0.3 * trouble < status.lost_share < 2.0 * trouble + 0.05
        attitude = flight.link.state.attitude
        assert attitude.time_s == pytest.approx(flight.clock.now(), abs=0.2 + late_s())


@pytest.mark.slow
@MAVSDK_ONCE
def test_strangers_change_nothing(flight: Rig) -> None:
    flight.run(for_s=0.5)
    codec = mavlink.MAVLink(None, 66, 1)
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3).pack(codec)
    tilted = mavlink.MAVLink_attitude_message(1000, 1.0, 0, 0, 0, 0, 0).pack(codec)
    rolls = []
    for _ in range(50):
        flight.stranger.send(b"\xfd\x00garbage" + beat + tilted)
        flight.run(for_s=0.02)
        attitude = flight.link.state.attitude
        rolls.append(0.0 if attitude is None else attitude.roll_rad)
    assert max(map(abs, rolls)) < 0.5
    assert flight.link.state.mode == "LOITER"
    assert flight.link.status(flight.clock.now()).vehicle_id == 1


@pytest.mark.slow
@MAVSDK_ONCE
def test_a_signed_link_flies_and_the_unsigned_word_of_others_counts_for_nothing(
    kind: LinkKind, flavour: str, tmp_path: Path
) -> None:
    key = tmp_path / "key"
    key.write_bytes(SECRET.hex().encode())
    key.chmod(0o600)
    with rig(kind, flavour, key=key) as flight:
        flight.connect()
        flight.enter_setpoint_mode()
        flight.run(lambda: flight.autopilot.state.velocity_m_s[0] > 1.0, VelocitySetpoint(2.0))
        landed = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
        flight.stranger.send(landed.pack(mavlink.MAVLink(None, 1, 1)))
        flight.run(setpoint=VelocitySetpoint(2.0), for_s=0.3)
        assert flight.link.state.obeys_setpoints
        status = flight.link.status(flight.clock.now())
        assert status.refused == {"not signed": 1}
        assert status.signed


@pytest.mark.slow
@MAVSDK_ONCE
def test_nonsense_in_the_vehicles_own_name_raises_nothing(flight: Rig) -> None:
    lots = random.Random(4)
    numbers = [0, 30, 32, 33, 77, 111, 245, 253]
    before = flight.link.status(flight.clock.now()).received
    for _ in range(100):
        for number in numbers:
            payload = lots.randbytes(lots.randrange(1, 60))
            body = bytes((0xFD, len(payload), 0, 0, lots.randrange(256), 1, 1, number, 0, 0))
            body += payload
            crc_extra = mavlink.mavlink_map[number].crc_extra
            flight.stranger.send(body + checksum(body, crc_extra))
        flight.run(for_s=0.02)
        flight.link.take_notes()
    assert flight.link.status(flight.clock.now()).received > before + 700
    flight.run(lambda: flight.link.state.mode == "LOITER")
    flight.connect()
