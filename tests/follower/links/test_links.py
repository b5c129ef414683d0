"""What a link is refused, hears and says; `test_link_contract.py` has what both links promise."""

import json
from pathlib import Path

import pytest
import yaml
from pymavlink.dialects.v20 import common as mavlink
from small_scenario import small_scenario

from follower.links.connections import ConnectionFailedError
from follower.links.mavsdk_link import stands_still
from follower.links.pymavlink_link import MavlinkLink
from follower.links.vehicle_monitor import mode_name, set_mode_params
from follower.settings.link import LinkSettings
from follower.simulation.autopilot_connection import other_end
from follower.simulation.options import SimulationOptions
from follower.simulation.run import simulate
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.setpoint import VelocitySetpoint


def test_modes_have_their_names() -> None:
    px4, ardupilot = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    assert mode_name(px4, 6 << 16) == "OFFBOARD"
    assert mode_name(ardupilot, 4) == "GUIDED"
    assert mode_name(ardupilot, 5) == "LOITER"
    assert set_mode_params(px4, "OFFBOARD") == (1.0, 6.0, 0.0)
    assert set_mode_params(ardupilot, "GUIDED") == (1.0, 4.0, 0.0)
    with pytest.raises(ValueError, match="PX4 has no mode 'GUIDED'"):
        set_mode_params(px4, "GUIDED")


class Peer:
    """The autopilot's end, spoken by hand."""

    def __init__(self) -> None:
        ours, theirs = MemoryTransport.pair()
        self.link = MavlinkLink(ours, LinkSettings(listen_s=0.0))
        self._transport = theirs
        self._codec = mavlink.MAVLink(None, 7, 1)

    def say(self, message: object, codec: mavlink.MAVLink | None = None) -> None:
        self._transport.send(message.pack(codec or self._codec))  # type: ignore[attr-defined]

    def heartbeat(self) -> None:
        px4 = mavlink.MAV_AUTOPILOT_PX4
        self.say(mavlink.MAVLink_heartbeat_message(2, px4, 129, 6 << 16, 4, 3))

    def heard(self) -> list[object]:
        return self._codec.parse_buffer(self._transport.receive()) or []


def test_nothing_is_sent_before_a_vehicle_was_heard_nor_what_is_not_finite() -> None:
    peer = Peer()
    peer.link.send(VelocitySetpoint(1.0))
    assert peer.heard() == []
    peer.heartbeat()
    peer.link.poll(1.0)
    with pytest.raises(ValueError, match="not finite"):
        peer.link.send(VelocitySetpoint(float("nan")))


@pytest.mark.parametrize(
    ("kind", "autopilot"),
    [
        (mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID),
        (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_PX4),
    ],
)
def test_a_program_that_beats_by_the_vehicles_numbers_does_not_change_its_mode(
    kind: int, autopilot: int
) -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(1.0)
    peer.say(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3))
    peer.link.poll(2.5)
    vehicle = peer.link.state
    assert (vehicle.mode, vehicle.armed, vehicle.heartbeat_s) == ("OFFBOARD", True, 1.0)
    assert peer.link.health.vehicle_type == mavlink.MAV_TYPE_QUADROTOR
    peer.say(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3))
    peer.link.poll(3.5)
    told = [note for note in peer.link.take_notes() if "heartbeats" in note]
    said = "another program with the autopilot's numbers, 7/1, sends heartbeats and is ignored"
    assert told == [said]


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_telemetry_that_is_not_finite_is_dropped(bad: float) -> None:
    peer = Peer()
    peer.heartbeat()
    peer.say(mavlink.MAVLink_attitude_message(1000, 0.1, 0, 0, 0, 0, 0))
    peer.say(mavlink.MAVLink_attitude_message(1020, bad, 0, 0, 0, 0, 0))
    peer.say(mavlink.MAVLink_local_position_ned_message(1020, 1, 2, bad, 0, 0, 0))
    peer.link.poll(5.0)
    assert peer.link.state.attitude.roll_rad == pytest.approx(0.1)
    assert peer.link.state.position is None


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_USER_1, mavlink.MAV_RESULT_DENIED),
    ],
)
def test_what_a_ground_station_asks_of_every_component_is_not_denied_as_consent_is(
    command: int, answer: int
) -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(0.5)
    request = mavlink.MAVLink_command_long_message(7, 191, command, 0, 148.0, *(0.0,) * 6)
    peer.say(request, mavlink.MAVLink(None, 255, 190))
    peer.link.poll(1.0)
    (asked,) = peer.link.take_commands()
    peer.heard()
    peer.link.answer(asked, accepted=False)
    assert [ack.result for ack in peer.heard()] == [answer]


LONG = "PreArm: Battery 1 below minimum arming voltage, and capacity too low to arm: charge it"


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ([0, 1], [LONG, "Ready"]),
        ([0, 0, 1, 1], [LONG, "Ready"]),  # doubled by the network
        ([0], [LONG[:50], "Ready"]),  # the last one lost
        ([1], [LONG[50:], "Ready"]),
    ],
)
def test_a_text_that_is_longer_than_a_message_is_told_whole(
    parts: list[int], told: list[str]
) -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(0.5)
    peer.link.take_notes()
    for part in parts:
        text = LONG[50 * part :][:50].encode()
        peer.say(mavlink.MAVLink_statustext_message(4, text, 7, part))
    peer.say(mavlink.MAVLink_statustext_message(6, b"Ready"))
    peer.link.poll(1.0)
    assert peer.link.take_notes() == told


def test_what_came_of_a_long_text_is_told_though_nothing_follows() -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(0.5)
    peer.link.take_notes()
    peer.say(mavlink.MAVLink_statustext_message(4, LONG[:50].encode(), 7, 0))
    peer.link.poll(1.0)
    assert peer.link.take_notes() == []
    peer.heartbeat()
    peer.link.poll(3.1)
    assert LONG[:50] in peer.link.take_notes()


def test_a_text_does_not_command_the_terminal() -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(0.5)
    peer.link.take_notes()
    peer.say(mavlink.MAVLink_statustext_message(4, b"\x1b[2Jgone\r"))
    peer.link.poll(1.0)
    assert peer.link.take_notes() == [" [2Jgone "]


def test_refusals_and_texts_are_told_once() -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(0.5)
    peer.link.take_notes()
    peer.say(mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_DO_SET_MODE, 1))
    peer.say(mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_NAV_LAND, 4, 0, 0, 255, 190))
    peer.say(mavlink.MAVLink_statustext_message(2, b"Failsafe activated"))
    peer.link.poll(1.0)
    notes = peer.link.take_notes()
    assert notes == ["MAV_CMD_DO_SET_MODE: MAV_RESULT_TEMPORARILY_REJECTED", "Failsafe activated"]
    assert peer.link.take_notes() == []


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("udpin:0.0.0.0:14540", "udpout:127.0.0.1:14540"),
        ("udp:127.0.0.1:14540", "udpout:127.0.0.1:14540"),
        ("udpout:127.0.0.1:14540", "udpin:127.0.0.1:14540"),
        ("tcpin:127.0.0.1:5760", "tcp:127.0.0.1:5760"),
    ],
)
def test_a_simulated_autopilot_takes_the_other_end(ours: str, theirs: str) -> None:
    assert other_end(ours) == theirs


def test_a_simulated_autopilot_is_on_no_serial_port() -> None:
    with pytest.raises(ConnectionFailedError, match="--autopilot external"):
        other_end("/dev/ttyACM0:57600")


def test_mavsdk_in_lockstep_is_refused() -> None:
    with pytest.raises(SettingsError, match="--link pymavlink"):
        simulate(SimulationOptions("demo", lockstep=True, link="mavsdk"))


def test_a_link_that_there_is_not_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(SettingsError, match="--link dronekit: choose pymavlink or mavsdk"):
        simulate(SimulationOptions("demo", link="dronekit"))


@pytest.mark.parametrize(
    ("values", "still"),
    [
        ((0.0, 0.0, 0.0, 0.0), True),
        ((0.0, -0.0, 0.0, 0.0), True),
        ((0.0, 0.0, 0.1, 0.0), False),
        ((3.0, 0.0, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0, -0.2), False),
    ],
)
def test_only_a_setpoint_without_any_motion_stands_still(
    values: tuple[float, float, float, float], still: bool
) -> None:
    vx, vy, vz, yaw_rate = values
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        12345, 1, 1, 8, 0x5C7, 0, 0, 0, vx, vy, vz, 0, 0, 0, 0, yaw_rate
    )
    assert stands_still(message.pack(mavlink.MAVLink(None, 1, 191))) is still


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "flavour"), [("pymavlink", "px4"), ("mavsdk", "ardupilot")])
def test_a_pursuit_is_flown(kind: str, flavour: str, tmp_path: Path) -> None:
    scenario = tmp_path / "small.yaml"
    scenario.write_text(small_scenario(11, 5))
    simulate(
        SimulationOptions(
            str(scenario),
            autopilot=flavour,
            out=tmp_path,
            video=False,
            link=kind,
        )
    )
    score = json.loads((tmp_path / "small" / "score.json").read_text())["score"]
    assert score["following_share"] > 0.8
    assert score["in_frame_share"] > 0.9
    assert score["range_error_median"] < 0.25
    config = yaml.safe_load((tmp_path / "small" / "config.yaml").read_text())
    assert config["settings"]["link"]["kind"] == kind
    report = (tmp_path / "small" / "report.html").read_text()
    assert f"{kind} to {flavour} 1, " in report
    assert (tmp_path / "small" / "mavlink.tlog").stat().st_size > 100_000
