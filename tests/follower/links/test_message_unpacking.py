"""Messages unpacked without a second look at their checksum are those that pymavlink decodes."""

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.links.packet_parser import PacketReader, Unpacker

NUMBERS = st.floats(-100, 100, width=32)


@given(st.tuples(*[NUMBERS] * 6), st.booleans())
def test_an_attitude_is_unpacked_as_pymavlink_does(
    numbers: tuple[float, ...], first_protocol: bool
) -> None:
    message = mavlink.MAVLink_attitude_message(12345, *numbers)
    data = message.pack(mavlink.MAVLink(None, 3, 1), force_mavlink1=first_protocol)
    (packet,) = PacketReader().feed(bytes(data))
    expected = mavlink.MAVLink(None).decode(bytearray(data))
    assert Unpacker().message(packet).to_dict() == expected.to_dict()


def test_a_text_is_unpacked_too() -> None:
    data = mavlink.MAVLink_statustext_message(6, b"Ready").pack(mavlink.MAVLink(None, 3, 1))
    (packet,) = PacketReader().feed(bytes(data))
    assert Unpacker().message(packet).text == "Ready"
