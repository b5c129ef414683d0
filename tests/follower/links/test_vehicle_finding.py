"""Which vehicle is ours, how often it speaks, and how we present ourselves."""

import io
import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink
from rich.console import Console

from follower.flight.status import LiveStatus
from follower.links.pymavlink_link import MavlinkLink
from follower.links.request_scheduler import MessageRate, MessageRates
from follower.links.status import LinkStatus
from follower.settings.link import LinkSettings
from follower.ui.terminal.flight_display import status_table
from follower_control.common.transport import MemoryTransport

PX4, ARDUPILOT = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
QUADROTOR = mavlink.MAV_TYPE_QUADROTOR


class Air:
    """Everybody who can be heard on the link, spoken by hand."""

    def __init__(self, **settings: Any) -> None:
        ours, self._transport = MemoryTransport.pair()
        self.link = MavlinkLink(ours, LinkSettings(**settings))
        self._ears = mavlink.MAVLink(None)

    def say(self, message: Any, system: int = 1, component: int = 1) -> None:
        self._transport.send(message.pack(mavlink.MAVLink(None, system, component)))

    def beat(
        self, system: int, kind: int = QUADROTOR, autopilot: int = PX4, component: int = 1
    ) -> None:
        message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 129, 6 << 16, 4, 3)
        self.say(message, system, component)

    def heard(self, name: str) -> list[Any]:
        messages = self._ears.parse_buffer(self._transport.receive()) or []
        return [message for message in messages if message.get_type() == name]

    def pass_time(self, until_s: float, *systems: int) -> None:
        """Let these vehicles beat once a second from 0 on; the link is polled at 10 Hz."""
        for step in range(round(10 * until_s) + 1):
            if step % 10 == 0:
                for system in systems:
                    self.beat(system)
            self.link.poll(step / 10)


def test_the_only_vehicle_is_taken_after_listening_for_others() -> None:
    air = Air()
    air.pass_time(2.0, 42)
    assert not air.link.connected
    air.pass_time(3.0, 42)
    assert air.link.status(3.0).vehicle_id == 42
    assert air.link.autopilot_name == "px4"


def test_among_several_none_is_guessed_and_they_are_listed() -> None:
    air = Air()
    air.pass_time(5.0, 3, 1, 2)
    assert not air.link.connected
    problem = air.link.status(5.0).problem
    named = "1 (px4), 2 (px4), 3 (px4); choose one"
    assert problem.startswith(f"several vehicles send heartbeats: {named}")
    assert "--set link.vehicle_id=1" in problem
    assert air.heard("COMMAND_LONG") == []


def test_the_chosen_one_is_taken_at_once_and_the_others_are_told_of_once() -> None:
    air = Air(vehicle_id=2)
    air.beat(1)
    air.link.poll(0.0)
    assert not air.link.connected
    air.pass_time(3.0, 2, 1)
    assert air.link.status(3.0).vehicle_id == 2
    told = [note for note in air.link.take_notes() if "another vehicle" in note]
    assert told == ["another vehicle, system 1, sends heartbeats and is ignored"]


@pytest.mark.parametrize(
    ("kind", "autopilot", "component"),
    [
        (mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 190),
        (mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID, 154),
        (mavlink.MAV_TYPE_GIMBAL, ARDUPILOT, 1),
        (mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID, 100),
        (mavlink.MAV_TYPE_ADSB, mavlink.MAV_AUTOPILOT_INVALID, 156),
        (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 191),
        (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, PX4, 1),
        (mavlink.MAV_TYPE_ANTENNA_TRACKER, ARDUPILOT, 1),
        (QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC, 1),
        (QUADROTOR, PX4, 100),
    ],
)
def test_who_is_no_vehicle_is_not_taken_for_one(kind: int, autopilot: int, component: int) -> None:
    air = Air(listen_s=0.0)
    air.beat(9, kind, autopilot, component)
    air.link.poll(0.0)
    assert not air.link.connected
    assert air.link.status(0.0).problem == ""
    air.pass_time(1.0, 1)
    assert air.link.status(1.0).vehicle_id == 1


def test_a_vehicle_that_fell_silent_does_not_stand_in_the_way_for_ever() -> None:
    air = Air()
    air.beat(200)
    air.pass_time(9.0, 1)
    assert not air.link.connected
    air.pass_time(12.0, 1)
    assert air.link.status(12.0).vehicle_id == 1


STREAMED = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
    mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT,
}


def _asked(air: Air) -> list[int]:
    """Return what was asked for at a rate."""
    number = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    return [int(m.param1) for m in air.heard("COMMAND_LONG") if m.command == number]


def test_messages_are_asked_for_and_asked_for_again_where_they_are_too_slow() -> None:
    air = Air(vehicle_id=1, attitude_rate_hz=50.0)
    air.beat(1)
    air.link.poll(0.0)
    assert sorted(_asked(air)) == sorted(STREAMED)
    for step in range(1, 600):
        now_s = 0.02 * step
        if step % 50 == 0:
            air.beat(1)
        air.say(mavlink.MAVLink_attitude_message(20 * step, 0, 0, 0, 0, 0, 0))
        if step % 100 == 0:  # at half a hertz instead of thirty
            air.say(mavlink.MAVLink_local_position_ned_message(20 * step, 0, 0, 0, 0, 0, 0))
        air.link.poll(now_s)
    asked = _asked(air)
    assert 30 not in asked
    assert asked.count(32) == 2  # after 3 s and after 6 s more
    said = [note for note in air.link.take_notes() if note.startswith("LOCAL_POSITION_NED")]
    assert said == ["LOCAL_POSITION_NED comes at 0.5 Hz, not at 30; asking again"]


def test_the_origin_is_asked_for_singly() -> None:
    """Of PX4 it comes only when it changes, whatever rate is asked for."""
    air = Air(vehicle_id=1)
    air.beat(1)
    air.link.poll(0.0)
    asked = [m for m in air.heard("COMMAND_LONG") if m.command == mavlink.MAV_CMD_REQUEST_MESSAGE]
    assert {int(m.param1) for m in asked} == {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    }


def test_after_a_silence_everything_is_asked_for_again_at_once() -> None:
    air = Air(vehicle_id=1)
    air.beat(1)
    air.link.poll(0.0)
    _asked(air)
    for second in range(1, 60):
        air.link.poll(float(second))
    _asked(air)
    air.beat(1)  # it was restarted meanwhile
    air.link.poll(60.0)
    assert sorted(_asked(air)) == sorted(STREAMED)


def test_a_rate_is_that_of_the_last_two_seconds() -> None:
    rates = MessageRates({"ATTITUDE": 100.0})
    for step in range(1000):
        rates.count("ATTITUDE", 0.02 * step)
    assert rates.measured(19.98) == (MessageRate("ATTITUDE", 100.0, 50.0),)
    assert rates.measured(25.0)[0].measured_hz == 0.0


def test_timesync_of_the_autopilot_is_answered() -> None:
    air = Air(vehicle_id=1)
    air.beat(1)
    air.say(mavlink.MAVLink_timesync_message(0, 777))
    air.link.poll(2.5)
    answers = [m for m in air.heard("TIMESYNC") if m.tc1 != 0]
    assert [(m.tc1, m.ts1) for m in answers] == [(2_500_000_000, 777)]


def test_the_status_says_in_a_line_how_the_link_is() -> None:
    rates = (MessageRate("ATTITUDE", 100.0, 99.6), MessageRate("LOCAL_POSITION_NED", 30.0, 29.7))
    status = LinkStatus(
        "pymavlink", 1, "px4", round_trip_s=0.021, rates=rates, of_vehicle=990, lost=10
    )
    assert status.line() == (
        "pymavlink to px4 1, 21 ms and back, attitude 100 Hz, local_position_ned 30 Hz, 1.0% lost"
    )
    nothing = LinkStatus("pymavlink", skipped_bytes=500)
    assert "no MAVLink: wrong baud rate?" in nothing.line()


def test_the_terminal_shows_the_link() -> None:
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(status_table(LiveStatus(1.0, link="pymavlink to px4 1, 21 ms and back")))
    assert "link          pymavlink to px4 1, 21 ms and back" in console.export_text()


def test_a_wanted_vehicle_is_given_time_to_speak_before_others_are_called_a_problem() -> None:
    air = Air(vehicle_id=1)
    air.pass_time(0.4, 2)
    assert air.link.status(0.4).problem == ""
    air.pass_time(2.6, 2)
    assert "system 1 sends no heartbeat, but 2 (px4)" in air.link.status(2.6).problem


@pytest.mark.parametrize("autopilot", [PX4, ARDUPILOT])
def test_ardupilot_is_never_told_a_place_that_is_no_number(autopilot: int) -> None:
    air = Air(vehicle_id=1)
    air.beat(1, autopilot=autopilot)
    air.link.poll(0.0)
    air.heard("")
    air.link.take_off(5.0)
    (command,) = air.heard("COMMAND_LONG")
    place = command.param4, command.param5, command.param6
    if autopilot == ARDUPILOT:
        assert (*place, command.param7) == (0.0, 0.0, 0.0, 5.0)
    else:
        assert all(map(math.isnan, place))
