"""Connection strings, the autopilot's clock and the link's own promises."""

import socket
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.links.connections import ConnectionFailedError, open_connection
from follower.links.pymavlink_link import MavlinkLink
from follower.links.vehicle_monitor import mode_name, set_mode_params
from follower.settings.link import LinkSettings
from follower.simulation.autopilot_connection import other_end
from follower.simulation.options import SimulationOptions
from follower.simulation.run import simulate
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport, UdpTransport
from follower_control.vehicle.setpoint import VelocitySetpoint


@pytest.mark.parametrize("text", ["", "udpin", "udpin:14540", "com3:57600:1", "udpin:h:99999"])
def test_a_string_that_is_no_connection_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConnectionFailedError, match=r"udpin:|between 1 and 65535"):
        open_connection(text)


def test_a_port_in_use_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(ConnectionFailedError, match=f"127.0.0.1:{port}.*in use.*--connect"):
            open_connection(f"udpin:127.0.0.1:{port}")


def test_udp_carries_bytes_both_ways() -> None:
    listener = UdpTransport.listen("127.0.0.1", 0)
    caller = UdpTransport.connect("127.0.0.1", listener.port)
    try:
        listener.send(b"nobody is there yet")
        caller.send(b"hello")
        assert _receive(listener) == b"hello"
        listener.send(b"answer")
        assert _receive(caller) == b"answer"
    finally:
        listener.close()
        caller.close()


def _receive(transport: UdpTransport) -> bytes:
    for _ in range(1000):
        data = transport.receive()
        if data:
            return data
        time.sleep(0.001)
    return b""


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
        self._codec.robust_parsing = True

    def say(self, message: object, system: int = 7) -> None:
        self._codec.srcSystem = system
        self._transport.send(message.pack(self._codec))  # type: ignore[attr-defined]

    def heartbeat(self, system: int = 7, autopilot: int = mavlink.MAV_AUTOPILOT_PX4) -> None:
        self.say(mavlink.MAVLink_heartbeat_message(2, autopilot, 129, 6 << 16, 4, 3), system)

    def heard(self) -> list[object]:
        return self._codec.parse_buffer(self._transport.receive()) or []


def test_a_setpoint_is_body_frame_8_with_velocity_and_yaw_rate_to_the_vehicle_heard() -> None:
    peer = Peer()
    peer.link.send(VelocitySetpoint(1.0))
    assert peer.heard() == []  # nobody is addressed before a heartbeat
    peer.heartbeat()
    peer.link.poll(1.0)
    peer.heard()
    peer.link.send(VelocitySetpoint(1.0, -2.0, 0.5, 0.25))
    (message,) = peer.heard()
    assert message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"  # type: ignore[attr-defined]
    fields = message.to_dict()  # type: ignore[attr-defined]
    wanted = {"coordinate_frame": 8, "type_mask": 0x5C7, "target_system": 7, "target_component": 1}
    assert {key: fields[key] for key in wanted} == wanted
    assert [fields[key] for key in ("vx", "vy", "vz", "yaw_rate")] == [1.0, -2.0, 0.5, 0.25]
    assert message.get_srcComponent() == 191  # type: ignore[attr-defined]


def test_what_is_not_finite_is_never_sent() -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(1.0)
    with pytest.raises(ValueError, match="not finite"):
        peer.link.send(VelocitySetpoint(float("nan")))


def test_our_heartbeat_is_an_onboard_controllers_of_the_vehicles_system() -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(1.0)
    beats = [m for m in peer.heard() if m.get_type() == "HEARTBEAT"]  # type: ignore[attr-defined]
    assert [(b.type, b.autopilot, b.get_srcSystem()) for b in beats] == [  # type: ignore[attr-defined]
        (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 7)
    ]


def test_other_systems_and_ground_stations_are_not_taken_for_the_vehicle() -> None:
    peer = Peer()
    peer.heartbeat(255, mavlink.MAV_AUTOPILOT_INVALID)
    peer.link.poll(1.0)
    assert not peer.link.connected
    peer.heartbeat(7)
    peer.say(mavlink.MAVLink_attitude_message(1000, 0.3, 0, 0, 0, 0, 0), system=8)
    peer.link.poll(1.1)
    assert peer.link.state.mode == "OFFBOARD"
    assert peer.link.state.attitude is None


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_telemetry_that_is_not_finite_is_dropped(bad: float) -> None:
    peer = Peer()
    peer.heartbeat()
    peer.say(mavlink.MAVLink_attitude_message(1000, 0.1, 0, 0, 0, 0, 0))
    peer.say(mavlink.MAVLink_attitude_message(1020, bad, 0, 0, 0, 0, 0))
    peer.say(mavlink.MAVLink_local_position_ned_message(1020, 1, 2, bad, 0, 0, 0))
    peer.link.poll(5.0)
    assert peer.link.state.attitude is not None
    assert peer.link.state.attitude.roll_rad == pytest.approx(0.1)
    assert peer.link.state.position is None


@given(st.binary(max_size=300))
def test_any_bytes_are_survived(data: bytes) -> None:
    peer = Peer()
    peer._transport.send(data)
    peer.link.poll(1.0)
    for _ in range(40):  # a broken header may swallow 280 bytes, not all that follows
        peer.heartbeat()
    peer.link.poll(2.0)
    assert peer.link.state.heartbeat_s == 2.0


def test_refusals_and_texts_are_told_once() -> None:
    peer = Peer()
    peer.heartbeat()
    peer.link.poll(0.5)
    peer.link.take_notes()
    peer.say(mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_DO_SET_MODE, 1))
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
