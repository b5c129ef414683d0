"""What mavsdk's stream lets through while the control loop stands still."""

import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.links.mavsdk_link import stands_still


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
