"""A whole flight whose target is chosen, tuned and dropped from a ground station alone."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.log import ControlRecord
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.settings.settings import load_settings
from follower.settings.ui import GroundStationSettings
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower.ui.ground_station.flight_view import CameraOptics
from follower.ui.ground_station.server import GroundStation
from follower_control.common.transport import MemoryTransport, Transport
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.selection import colour_from_hex, find_by_colour
from follower_vision.trackers.track import Track

pytestmark = pytest.mark.slow

WIDTH, HEIGHT = 320, 240
EARTH_M, START_M = 6_371_000.0, -18.0
BLUE = "#2050d0"
SELECT_S, TUNE_S, MODE_S, DROP_S, END_S = 10.0, 13.0, 14.0, 15.0, 20.0
SCENARIO = {
    "name": "test",
    "title": "Two cars on a meadow.",
    "duration_s": END_S,
    "seed": 3,
    "targets": [
        {"kind": "car", "colour": "#e0401c", "path": {"points": [[0, 0], [1, 0]]}},
        {"kind": "car", "colour": BLUE, "path": {"points": [[4, 7], [5, 7]]}},
    ],
    "camera": {"width": WIDTH, "height": HEIGHT, "fov_deg": 90, "pitch_deg": -14, "rate_hz": 15},
    "start": {"at": [-18, 0], "heading_deg": 0},
    "takeoff_height_m": 8,
    "select": {"colour": "#e0401c"},
    "follow": {"servo": {"distance_m": 14.0, "target_size_m": 2.2, "elevation_deg": -25}},
}


class Flight:
    """Flown on a simulated clock, with what a pilot does in a ground station at its times."""

    def __init__(self, share: Callable[..., Transport]) -> None:
        wanted, self.clock = Scenario.model_validate(SCENARIO), SimulatedClock()
        ours, autopilot = MemoryTransport.pair()
        near, self._far = MemoryTransport.pair()
        settings = load_settings(base=base_settings(wanted))
        ends = share(ours, near), autopilot
        self._picture: Frame | None = None
        shown = FlightOptions(video=self)
        self.flight = SimulatedFlight(World(wanted), settings, "px4", self.clock, ends, shown)
        self.flight.operate()
        ground, view = GroundStationSettings(enabled=True), self.flight.view
        self._station = GroundStation(ground, view, CameraOptics(90.0, 15.0), self.clock)
        self._codec = mavlink.MAVLink(None, 255, 190)
        self._codec.robust_parsing = True
        self.heard: list[tuple[float, Any]] = []
        self._script = self._pilot()
        fly_lockstep(self.flight, self.clock, self._each)

    def _each(self) -> None:
        next(self._script, None)
        self._station.step(self.clock.now())
        for one in self._codec.parse_buffer(bytearray(self._far.receive())) or ():
            self.heard.append((self.clock.now(), one))

    def _pilot(self) -> Iterator[None]:
        while self.clock.now() < SELECT_S:
            yield
        box = self.blue_box()
        corners = box.left / WIDTH, box.top / HEIGHT, box.right / WIDTH, box.bottom / HEIGHT
        self._command(mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE, *corners)
        self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 275, 200_000)
        self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 276, 500_000)
        while self.clock.now() < TUNE_S:
            yield
        real = mavlink.MAV_PARAM_TYPE_REAL32
        self._send(mavlink.MAVLink_param_set_message(1, 191, b"SRV_DIST", 10.0, real))
        while self.clock.now() < MODE_S:
            yield
        self._send(mavlink.MAVLink_param_set_message(1, 191, b"SRV_AZ_KP", 2.5, real))
        while self.clock.now() < DROP_S:
            yield
        self._command(mavlink.MAV_CMD_CAMERA_STOP_TRACKING)

    def blue_box(self) -> Box:
        """Return where the blue car is in the newest picture: what a person would draw."""
        return find_by_colour(self._picture.image, colour_from_hex(BLUE))[0]

    def add(self, frame: Frame, _tracks: Sequence[Track], _lines: Sequence[str]) -> None:
        """Watch the video."""
        self._picture = frame

    def _command(self, number: int, *params: float) -> None:
        padded = (*params, *([0.0] * (7 - len(params))))
        self._send(mavlink.MAVLink_command_long_message(1, 100, number, 0, *padded))

    def _send(self, message: Any) -> None:
        self._far.send(message.pack(self._codec))

    def at(self, time_s: float) -> ControlRecord:
        return next(one for one in self.flight.log.controls if one.time_s >= time_s)

    def of(self, name: str) -> list[tuple[float, Any]]:
        return [(at, one) for at, one in self.heard if one.get_type() == name]


@pytest.fixture(scope="module")
def flight(share: Callable[..., Transport]) -> Flight:
    return Flight(share)


def test_nothing_is_followed_before_a_box_is_drawn(flight: Flight) -> None:
    assert flight.at(SELECT_S - 0.1).state is SupervisorState.IDLE


def test_the_car_that_was_drawn_around_is_followed(flight: Flight) -> None:
    record = flight.at(TUNE_S - 0.5)
    assert record.state is SupervisorState.FOLLOWING
    assert record.estimate is not None
    body = record.vehicle.position
    assert body is not None
    statuses = [one for at, one in flight.of("CAMERA_TRACKING_IMAGE_STATUS") if at > SELECT_S + 0.5]
    assert len(statuses) >= 15
    told = [one for one in statuses if one.tracking_status == 1]
    assert len(told) > 15
    assert all(0 <= one.rec_top_x < one.rec_bottom_x <= 1 for one in told)
    acks = {(one.command, one.result) for _, one in flight.of("COMMAND_ACK")}
    accepted = mavlink.MAV_RESULT_ACCEPTED
    assert (mavlink.MAV_CMD_CAMERA_TRACK_RECTANGLE, accepted) in acks


def test_the_targets_place_is_told_at_the_rate_asked_for(flight: Flight) -> None:
    told = [one for at, one in flight.of("CAMERA_TRACKING_GEO_STATUS") if at < DROP_S]
    assert len(told) == pytest.approx((DROP_S - SELECT_S) / 0.5, abs=2)
    origin = flight.at(TUNE_S).vehicle.origin
    newest = told[-1]
    assert newest.tracking_status == 1
    north_m = math.radians(newest.lat * 1e-7 - origin.latitude_deg) * EARTH_M + START_M
    level_m = EARTH_M * math.cos(math.radians(origin.latitude_deg))
    east_m = math.radians(newest.lon * 1e-7 - origin.longitude_deg) * level_m
    assert math.hypot(north_m - 4, east_m - 7) < 3 * newest.h_acc < 15
    assert newest.vel_acc > math.hypot(newest.vel_n, newest.vel_e) / 3, "it stands"


def test_settings_change_in_flight_without_a_step(flight: Flight) -> None:
    servo = flight.flight.stage.settings.servo
    assert (servo.distance_m, servo.azimuth.kp) == (10.0, 2.5)
    changed = [one for one in flight.flight.log.controls if one.changes]
    assert [change.key for one in changed for change in one.changes] == [
        "servo.distance_m",
        "servo.azimuth.kp",
    ]
    steps = flight.flight.log.controls
    for record in changed:
        index = steps.index(record)
        before, after = steps[index - 1].asked.values, record.asked.values
        assert after == pytest.approx(before, abs=0.05)


def test_stopping_the_tracking_holds_and_is_release(flight: Flight) -> None:
    record = flight.at(DROP_S + 0.5)
    assert (record.state, record.reason) == (SupervisorState.HOLDING, SupervisorReason.NO_TARGET)
    assert flight.at(DROP_S + 3.6).state is SupervisorState.RELEASED
    assert flight.at(DROP_S + 3.6).allowed.forward_m_s == pytest.approx(0.0, abs=0.05)
    (*_, (_, newest)) = flight.of("CAMERA_TRACKING_IMAGE_STATUS")
    assert newest.tracking_status == 0
