"""What a link learns about health and parameters, from the bytes of both autopilots."""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.packet_parser import PacketReader, Unpacker
from follower.links.request_scheduler import ParameterReader
from follower.links.vehicle_health import HealthMonitor

PX4, ARDUPILOT = True, False
"""Whether integer parameters come as their bytes."""
INT8, INT32, REAL32 = 2, 6, 9


def told(*messages: Any, now_s: float = 5.0) -> HealthMonitor:
    """Pack messages as an autopilot does, and read the bytes."""
    monitor, codec = HealthMonitor(), mavlink.MAVLink(None, 1, 1)
    data = b"".join(message.pack(codec) for message in messages)
    for packet in PacketReader().feed(data):
        message = Unpacker().message(packet)
        monitor.take(message.get_type(), message, now_s)
    return monitor


def as_float(number: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", number))[0])


@given(
    st.lists(st.floats(0, 5, width=32), min_size=5, max_size=6),
    st.integers(0, 0xFFFF),
)
def test_ardupilots_own_message_is_read_though_trailing_zeros_are_cut(
    ratios: list[float], flags: int
) -> None:
    message = mavlink.MAVLink_ekf_status_report_message(flags, *ratios)
    estimator = told(message).health.estimator
    assert estimator.flags == flags
    assert list(estimator.ratios.values()) == ratios[:4]
    assert estimator.gps_glitch == bool(flags & 0x8000)


def test_px4s_estimator_status_may_hold_nan_for_what_it_does_not_use() -> None:
    nan = float("nan")
    message = mavlink.MAVLink_estimator_status_message(9, 831, 0.2, nan, 0.4, 0.5, nan, nan, 1, 1)
    estimator = told(message).health.estimator
    assert tuple(estimator.ratios.values()) == pytest.approx((0.2, 0.0, 0.4, 0.5))


def test_what_the_autopilot_does_not_know_is_unknown() -> None:
    gps = mavlink.MAVLink_gps_raw_int_message(0, 1, 0, 0, 0, 65535, 65535, 65535, 65535, 255)
    status = mavlink.MAVLink_sys_status_message(7, 7, 5, 0, 0, -1, -1, 0, 0, 0, 0, 0, 0)
    health = told(gps, status).health
    assert (health.gps.fix_type, health.gps.satellites, health.gps.hdop) == (1, None, None)
    assert health.sensors.battery_share is None
    assert health.sensors.unhealthy == 2
    assert health.estimator is None


def test_the_firmwares_version_is_unpacked() -> None:
    version = mavlink.MAVLink_autopilot_version_message(
        0, 4 << 24 | 6 << 16 | 3 << 8 | 255, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 1
    )
    assert told(version).health.firmware == (4, 6, 3)


@pytest.mark.parametrize(
    ("bytewise", "kind", "carried", "value"),
    [
        (PX4, INT32, as_float(3), 3.0),
        (PX4, INT32, as_float(-1), -1.0),
        (PX4, REAL32, 1.5, 1.5),
        (ARDUPILOT, INT32, 16.0, 16.0),
        (ARDUPILOT, INT8, -2.0, -2.0),
    ],
)
def test_each_autopilots_encoding_of_parameters(
    bytewise: bool, kind: int, carried: float, value: float
) -> None:
    reader = ParameterReader(bytewise)
    reader.want(["NAME"])
    data = mavlink.MAVLink_param_value_message(b"NAME", carried, kind, 9, 1).pack(
        mavlink.MAVLink(None, 1, 1)
    )
    for packet in PacketReader().feed(data):
        message = Unpacker().message(packet)
        reader.take(message.param_id, message.param_value, message.param_type)
    assert reader.values == {"NAME": value}
    assert not reader.missing


def test_names_are_asked_for_a_few_at_once_again_and_then_given_up() -> None:
    reader = ParameterReader(bytewise=True)
    names = [f"P{number}" for number in range(12)]
    reader.want(names)
    asked: list[str] = []
    for step in range(300):
        due = reader.due(0.02 * step)
        assert len(due) <= 8
        asked += due
        for name in due:
            if name != "P7":
                reader.take(name, 1.0, REAL32)
    assert asked.count("P7") == 6
    assert sorted(set(asked)) == sorted(names)
    assert reader.missing == {"P7"}


def test_nobody_sets_what_was_not_asked_for_and_nan_is_no_value() -> None:
    reader = ParameterReader(bytewise=False)
    reader.want(["ASKED"])
    reader.take("OTHER", 1.0, REAL32)
    reader.take("ASKED", float("nan"), REAL32)
    assert reader.values == {}
    assert not reader.missing
