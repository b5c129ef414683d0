"""The pilot's sticks shift what is wanted, or take the vehicle back."""

from collections.abc import Callable
from typing import Any

import pytest
from people_flights import OURS, F, R, flavours

from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorReason
from follower_control.vehicle.setpoint import HOLD

MIDDLE = (1500, 1500, 1500, 1500)


Right = Callable[[ControlRecord], float]


NUDGES: list[tuple[int, int, Right]] = [
    (0, 1700, lambda record: record.asked.right_m_s),
    (0, 1300, lambda record: -record.asked.right_m_s),
    (1, 1300, lambda record: record.asked.forward_m_s),
    (1, 1700, lambda record: -record.asked.forward_m_s),
    (2, 1700, lambda record: -record.asked.down_m_s),
    (2, 1300, lambda record: record.asked.down_m_s),
    (3, 1700, lambda record: record.asked.yaw_rate_rad_s),
    (3, 1300, lambda record: -record.asked.yaw_rate_rad_s),
]


@pytest.mark.slow
@pytest.mark.parametrize(("channel", "pulse", "way"), NUDGES)
def test_sticks_shift_what_is_wanted_the_way_they_are_moved(
    rig_of: Any, channel: int, pulse: int, way: Right
) -> None:
    moved, asked = list(MIDDLE), []
    moved[channel] = pulse
    for sticks in (MIDDLE, moved):
        rig = rig_of("ardupilot", "sticks.nudge=true")
        rig.autopilot.move_sticks(*MIDDLE)
        rig.follow()
        rig.fly(1.0)
        rig.autopilot.move_sticks(*sticks)
        record = rig.fly(0.5)
        assert record.state is F
        asked.append(way(record))
    assert asked[1] > asked[0] + 0.02


@pytest.mark.slow
def test_sticks_do_nothing_unless_asked_for(rig_of: Any) -> None:
    rig, calm = rig_of("ardupilot"), rig_of("ardupilot")
    for one in (rig, calm):
        one.autopilot.move_sticks(*MIDDLE)
        one.follow()
    rig.autopilot.move_sticks(1700, 1300, 1700, 1300)
    assert rig.fly(1.0).asked == calm.fly(1.0).asked


@pytest.mark.slow
@flavours
def test_a_stick_moved_far_takes_over(rig_of: Any, flavour: str) -> None:
    rig = rig_of(flavour)
    rig.autopilot.move_sticks(*MIDDLE)
    rig.follow()
    rig.fly(0.5)
    moved_s = rig.now_s
    rig.autopilot.move_sticks(1500, 1150, 1500, 1500)
    record = rig.until(R, 0.3)
    assert record.reason is SupervisorReason.STICKS_MOVED
    assert rig.now_s - moved_s < 0.2
    record = rig.fly(3.0)
    assert (record.sent, rig.autopilot.mode) == (True, OURS[flavour])
    assert record.allowed.values == pytest.approx(HOLD.values, abs=1e-6)
