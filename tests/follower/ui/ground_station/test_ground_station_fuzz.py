"""Packets whose checksum is right and whose content is anything: nothing stops, nothing moves."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from follower.links.packet_parser import checksum, crc_extra_of
from follower.ui.ground_station.server import HEARD

MakeRig = Callable[..., Any]
REQUEST = mavlink.MAV_CMD_REQUEST_MESSAGE


def packet(message_id: int, payload: bytes, version: int, component: int) -> bytes:
    """Return a packet of MAVLink 1 or 2 with any payload and the right checksum."""
    extra = crc_extra_of(message_id)
    assert extra is not None
    if version == 1:
        head = bytes((0xFE, len(payload), 0, 255, component, message_id & 0xFF))
    else:
        head = bytes((0xFD, len(payload), 0, 0, 0, 255, component))
        head += message_id.to_bytes(3, "little")
    return head + payload + checksum(head + payload, extra)


payloads = st.binary(max_size=255) | st.binary(max_size=40).map(
    lambda data: bytes((1, 100)) + data.ljust(20, b"\1")
)


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.sampled_from(sorted(HEARD)), payloads), max_size=4))
def test_any_content_whatever_is_survived(
    make_rig: MakeRig, version: int, packets: list[tuple[int, bytes]]
) -> None:
    rig = make_rig(video_uri="rtsp://10.0.0.5/live")
    peer = rig.peer()
    for message_id, payload in packets:
        if version == 2 or message_id < 256:
            peer._socket.sendto(packet(message_id, payload, version, 190), peer._address)
    rig.run(0.06)
    rig.everybody.append(peer)
    before = len(peer.of("CAMERA_INFORMATION"))
    peer.command(REQUEST, 259)
    rig.run(0.06)
    assert len(peer.of("CAMERA_INFORMATION")) >= before + 1
