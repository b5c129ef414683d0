"""Parameters in both encodings, and what the simulated autopilot says of its health."""

import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower_control.common.transport import MemoryTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState

INT32, REAL32 = 6, 9


class Bench:
    """An autopilot on the ground, and the messages that it says."""

    def __init__(self, flavour: str) -> None:
        self._ours, theirs = MemoryTransport.pair()
        self.autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, 0.0)))
        self._codec = mavlink.MAVLink(None, 1, 191)
        self._now_s = 0.0

    def hear(self, *messages: Any, for_s: float = 0.1) -> dict[str, list[Any]]:
        for message in messages:
            self._ours.send(message.pack(self._codec))
        heard: dict[str, list[Any]] = {}
        end_s = self._now_s + for_s
        while self._now_s < end_s:
            self._now_s += 0.02
            self.autopilot.step(self._now_s)
            for message in self._codec.parse_buffer(self._ours.receive()) or []:
                heard.setdefault(message.get_type(), []).append(message)
        return heard


def bytes_as_float(number: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", number))[0])


def interval(message_id: int, period_us: float) -> Any:
    command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    return mavlink.MAVLink_command_long_message(
        1, 1, command, 0, message_id, period_us, 0, 0, 0, 0, 0
    )


@pytest.mark.parametrize(
    ("flavour", "name", "carried"),
    [
        ("px4", b"COM_RC_IN_MODE", bytes_as_float(3)),
        ("ardupilot", b"FS_OPTIONS", 16.0),
    ],
)
def test_px4_carries_an_integer_as_its_bytes_and_ardupilot_as_a_float(
    flavour: str, name: bytes, carried: float
) -> None:
    read = mavlink.MAVLink_param_request_read_message(1, 1, name, -1)
    (told,) = Bench(flavour).hear(read)["PARAM_VALUE"]
    assert (told.param_type, told.param_value) == (INT32, carried)


def test_px4_refuses_a_value_of_another_type_and_both_tell_what_holds() -> None:
    px4, ardupilot = Bench("px4"), Bench("ardupilot")
    for kind, value, holds in ((REAL32, 4.0, 3), (INT32, bytes_as_float(4), 4)):
        message = mavlink.MAVLink_param_set_message(1, 1, b"COM_RC_IN_MODE", value, kind)
        (told,) = px4.hear(message)["PARAM_VALUE"]
        assert told.param_value == bytes_as_float(holds)
        assert px4.autopilot.parameters["COM_RC_IN_MODE"] == holds
    message = mavlink.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 32.0, REAL32)
    (told,) = ardupilot.hear(message)["PARAM_VALUE"]
    assert told.param_value == ardupilot.autopilot.parameters["GUID_OPTIONS"] == 32.0


def test_neither_says_anything_about_a_parameter_that_it_does_not_have() -> None:
    for flavour, strange in (("px4", b"GUID_TIMEOUT"), ("ardupilot", b"COM_OF_LOSS_T")):
        read = mavlink.MAVLink_param_request_read_message(1, 1, strange, -1)
        set_ = mavlink.MAVLink_param_set_message(1, 1, strange, 1.0, REAL32)
        assert "PARAM_VALUE" not in Bench(flavour).hear(read, set_)


@pytest.mark.parametrize(
    ("flavour", "own", "others"),
    [("px4", "ESTIMATOR_STATUS", 193), ("ardupilot", "EKF_STATUS_REPORT", 230)],
)
def test_health_comes_at_the_interval_asked_for(flavour: str, own: str, others: int) -> None:
    bench = Bench(flavour)
    bench.autopilot.health.estimates = 7
    bench.autopilot.health.satellites = 4
    ids = [getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in (own, "GPS_RAW_INT")]
    heard = bench.hear(*(interval(number, 5e5) for number in ids), for_s=2.1)
    assert 4 <= len(heard[own]) <= 6
    assert heard[own][-1].flags == 7
    assert heard["GPS_RAW_INT"][-1].satellites_visible == 4
    (refusal,) = bench.hear(interval(others, 5e5))["COMMAND_ACK"]
    assert refusal.result != mavlink.MAV_RESULT_ACCEPTED
