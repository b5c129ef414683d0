"""The extended parameters, the camera definition file, and how a ground station gets it."""

import math
import struct
import zlib
from collections.abc import Callable
from typing import Any
from xml.etree.ElementTree import fromstring

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.ground_station.camera_definition import (
    PATH,
    definition_version,
    definition_xml,
)
from follower.ground_station.parameter_table import float32, parameters
from follower.settings import Settings, load_settings

MakeRig = Callable[..., Any]
CAMERA, REAL = 100, mavlink.MAV_PARAM_EXT_TYPE_REAL32
KP = "SRV_AZ_KP"
OPEN, READ, BURST, CRC, TERMINATE, LIST = 4, 5, 15, 14, 1, 3
ACK, NAK = 128, 129


def station(rig: Any, **options: Any) -> Any:
    peer = rig.peer(**options)
    rig.everybody.append(peer)
    rig.run(0.1)
    return peer


def number(message: Any) -> float:
    return float(struct.unpack("<f", message._param_value_raw.ljust(4, b"\0")[:4])[0])


def put(rig: Any, peer: Any, name: str, value: float, kind: int = REAL) -> Any:
    data = struct.pack("<f", value)
    peer.send(mavlink.MAVLink_param_ext_set_message(1, CAMERA, name.encode(), data, kind))
    rig.run(0.06)
    return peer.of("PARAM_EXT_ACK")[-1]


def test_a_list_brings_all_of_them(make_rig: MakeRig) -> None:
    rig = make_rig()
    peer = station(rig)
    peer.send(mavlink.MAVLink_param_ext_request_list_message(1, CAMERA))
    rig.run(4.0)
    values = {one.param_id: number(one) for one in peer.of("PARAM_EXT_VALUE", CAMERA)}
    assert values == {one.name: one.number(rig.settings) for one in parameters()}


def test_a_list_that_is_asked_for_again_and_again_comes_to_its_end(make_rig: MakeRig) -> None:
    rig = make_rig()
    peer = station(rig)
    for _ in range(4):
        peer.send(mavlink.MAVLink_param_ext_request_list_message(1, CAMERA))
        rig.run(1.0)
    told = {one.param_id for one in peer.of("PARAM_EXT_VALUE", CAMERA)}
    assert told == {one.name for one in parameters()}


def test_one_can_be_read_by_name_and_by_index(make_rig: MakeRig) -> None:
    rig = make_rig()
    peer = station(rig)
    index = [one.name for one in parameters()].index(KP)
    for name, which in ((KP, -1), ("", index), ("GONE", -1), ("", 9999)):
        message = mavlink.MAVLink_param_ext_request_read_message(1, CAMERA, name.encode(), which)
        peer.send(message)
    rig.run(0.1)
    assert [one.param_id for one in peer.of("PARAM_EXT_VALUE")] == [KP, KP]


def test_a_gain_is_set_acknowledged_and_taken(make_rig: MakeRig) -> None:
    rig = make_rig()
    peer = station(rig)
    ack = put(rig, peer, KP, 2.0)  # its bytes end in a zero, which MAVLink 2 leaves out
    assert (ack.param_result, number(ack)) == (mavlink.PARAM_ACK_ACCEPTED, 2.0)
    assert rig.requests.settings.servo.azimuth.kp == 2.0


@pytest.mark.parametrize(
    ("name", "value", "kind", "result"),
    [
        (KP, -1.0, REAL, mavlink.PARAM_ACK_VALUE_UNSUPPORTED),
        (KP, math.nan, REAL, mavlink.PARAM_ACK_VALUE_UNSUPPORTED),
        (KP, 1.0, mavlink.MAV_PARAM_EXT_TYPE_REAL64, mavlink.PARAM_ACK_VALUE_UNSUPPORTED),
        ("ENV_MAXSPD", 99.0, REAL, mavlink.PARAM_ACK_VALUE_UNSUPPORTED),
        ("GONE", 1.0, REAL, mavlink.PARAM_ACK_FAILED),
    ],
)
def test_a_bad_value_is_refused(
    make_rig: MakeRig, name: str, value: float, kind: int, result: int
) -> None:
    rig = make_rig()
    assert put(rig, station(rig), name, value, kind).param_result == result
    assert rig.requests.settings == rig.settings


def test_what_another_front_end_changes_is_told(make_rig: MakeRig) -> None:
    rig = make_rig()
    peer = station(rig)
    rig.requests.change("servo.azimuth.kp", 1.25, "the page")
    rig.run(0.2)
    (told,) = peer.of("PARAM_EXT_VALUE", CAMERA)
    assert (told.param_id, number(told)) == (KP, 1.25)
    for step in range(50):
        rig.requests.change("servo.azimuth.kp", 1.0 + 0.01 * step, "the page")
        rig.requests.take()
        rig.run(0.02)
    rig.run(0.1)
    rig.everybody.clear()
    before = len(peer.messages)
    rig.run(1.0)
    peer.hear()
    assert number(peer.of("PARAM_EXT_VALUE", CAMERA)[-1]) == pytest.approx(1.49)
    assert not [one for one in peer.messages[before:] if one.get_type() == "PARAM_EXT_VALUE"]


def test_the_definition_describes_every_parameter() -> None:
    root = fromstring(definition_xml(load_settings(base={"servo": {"distance_m": 20}})))
    rows = {row.get("name"): row for row in root.iter("parameter")}
    assert list(rows) == [one.name for one in parameters()]
    assert rows["SRV_DIST"].get("default") == "20"
    assert "wanted distance" in str(rows["SRV_DIST"].get("tooltip"))
    assert rows["SRV_DIST"].findtext("description") == "servo.distance_m (m)"
    modes = {one.get("name"): one.get("value") for one in rows["SRV_MODE"].iter("option")}
    assert modes["orbit"] == "3"
    assert all(row.get("tooltip") for row in rows.values())


def test_other_defaults_are_another_version() -> None:
    one, other = Settings(), load_settings(base={"servo": {"distance_m": 20}})
    assert definition_version(definition_xml(one)) != definition_version(definition_xml(other))


class FtpClient:
    """A ground station's end of MAVLink FTP."""

    def __init__(self, rig: Any, peer: Any) -> None:
        self.rig, self.peer, self.sequence = rig, peer, 0

    def ask(self, opcode: int, data: bytes = b"", offset: int = 0, size: int | None = None):
        """Return the answers: (opcode, data, offset, whether a burst ends)."""
        head = struct.pack(
            "<HBBBBBxI", self.sequence, 0, opcode, len(data) if size is None else size, 0, 0, offset
        )
        payload = list((head + data).ljust(251, b"\0"))
        before = len(self.peer.of("FILE_TRANSFER_PROTOCOL"))
        self.peer.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, CAMERA, payload))
        self.rig.run(0.1)
        answers = []
        for message in self.peer.of("FILE_TRANSFER_PROTOCOL")[before:]:
            raw = bytes(message.payload)
            sequence, _, kind, length, asked, ends, at = struct.unpack_from("<HBBBBBxI", raw)
            self.sequence = (self.sequence + 1) & 0xFFFF
            assert (sequence, asked) == (self.sequence, opcode)
            answers.append((kind, raw[12 : 12 + length], at, bool(ends)))
        return answers


def test_the_definition_is_fetched_by_mavlink_ftp_where_the_camera_says(make_rig: MakeRig) -> None:
    rig = make_rig()
    peer = station(rig)
    peer.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 259)
    rig.run(0.1)
    uri = peer.of("CAMERA_INFORMATION")[0].cam_definition_uri
    assert uri == f"mftp://[;comp=100]{PATH}"
    ftp, wanted = FtpClient(rig, peer), definition_xml(rig.settings)
    ((kind, data, _, _),) = ftp.ask(OPEN, PATH.encode())
    assert (kind, struct.unpack("<I", data)[0]) == (ACK, len(wanted))
    read = b""
    while len(read) < len(wanted):
        ((kind, data, at, _),) = ftp.ask(READ, offset=len(read), size=239)
        assert (kind, at) == (ACK, len(read))
        read += data
    assert read == wanted
    burst = b""
    while len(burst) < len(wanted):
        answers = ftp.ask(BURST, offset=len(burst), size=239)
        assert [ends for _, _, _, ends in answers] == [False] * (len(answers) - 1) + [True]
        burst += b"".join(data for _, data, _, _ in answers)
    assert burst == wanted
    assert ftp.ask(READ, offset=len(wanted), size=239)[0][:2] == (NAK, b"\x06")
    assert struct.unpack("<I", ftp.ask(CRC, PATH.encode())[0][1])[0] == zlib.crc32(wanted)
    assert ftp.ask(TERMINATE)[0][0] == ACK


@pytest.mark.parametrize("path", ["/etc/passwd", "../../etc/passwd", "", "/camera.xml/.."])
def test_there_is_no_other_file(make_rig: MakeRig, path: str) -> None:
    rig = make_rig()
    ftp = FtpClient(rig, station(rig))
    assert ftp.ask(OPEN, path.encode())[0][:2] == (NAK, b"\x0a")
    assert ftp.ask(LIST, path.encode())[0][:2] == (NAK, b"\x07")


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(min_size=12, max_size=251))
def test_any_payload_is_answered_within_reason(make_rig: MakeRig, payload: bytes) -> None:
    rig = make_rig()
    peer = station(rig)
    data = list(payload.ljust(251, b"\0"))
    peer.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, CAMERA, data))
    rig.run(0.06)
    assert 1 <= len(peer.of("FILE_TRANSFER_PROTOCOL")) <= 8


def test_an_address_of_ones_own_is_told_instead(make_rig: MakeRig) -> None:
    rig = make_rig(definition_uri="http://10.0.0.5/camera.xml")
    peer = station(rig)
    peer.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 259)
    rig.run(0.1)
    assert peer.of("CAMERA_INFORMATION")[0].cam_definition_uri == "http://10.0.0.5/camera.xml"


def test_without_parameters_it_is_a_basic_camera(make_rig: MakeRig) -> None:
    rig = make_rig(parameters=False)
    peer = station(rig)
    peer.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 259)
    rig.run(0.1)
    information = peer.of("CAMERA_INFORMATION")[0]
    assert (information.cam_definition_uri, information.cam_definition_version) == ("", 0)


def test_what_is_not_a_32_bit_number_is_the_nearest_one() -> None:
    assert float32(1e300) == math.inf
