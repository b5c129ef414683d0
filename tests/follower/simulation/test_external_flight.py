"""Flights of an autopilot that runs elsewhere: late, with its own origin, heading and time."""

import math
from dataclasses import replace
from typing import cast

import pytest

from follower.flight.control.takeoff_monitor import AutopilotWait
from follower.flight.log import FlightLog
from follower.flight.supervision.autonomy import AutonomyPhase
from follower.flight.supervision.supervisor import SupervisorState
from follower.links.connections import ConnectionFailedError
from follower.links.link import Link
from follower.links.status import LinkStatus
from follower.settings.settings import load_settings
from follower.simulation.components import FlightOptions
from follower.simulation.external_vehicle import TelemetryVehicle
from follower.simulation.flight import EXTERNAL, SimulatedFlight
from follower.simulation.options import VisionSource
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

FLAVOURS = ("px4", "ardupilot")
HEADING_RAD = math.radians(97.0)
START = (-18.0, 3.0)
DURATION_S = 12.0


def scenario() -> Scenario:
    """A red car drives off east of a drone that stands behind it and looks north."""
    return Scenario.model_validate(
        {
            "name": "elsewhere",
            "title": "A car on a meadow.",
            "duration_s": DURATION_S,
            "seed": 3,
            "targets": [
                {
                    "kind": "car",
                    "colour": "#e0401c",
                    "path": {
                        "points": [[0, 3], [60, 5], [120, 0]],
                        "speeds": [{"at_s": 3, "speed_m_s": 3.0, "acceleration_m_s2": 1.0}],
                    },
                }
            ],
            "camera": {"width": 320, "height": 240, "fov_deg": 90, "pitch_deg": -14, "rate_hz": 20},
            "start": {"at": START, "heading_deg": 0},
            "takeoff_height_m": 8,
            "select": {"colour": "#e0401c"},
            "follow": {
                "servo": {"distance_m": 14.0, "target_size_m": 2.2, "elevation_deg": -25},
                "link": {"vehicle_id": 1},
            },
        }
    )


class Elsewhere:
    """An autopilot that runs on, whoever flies with it."""

    def __init__(self, flavour: str) -> None:
        self._transport, theirs = MemoryTransport.pair()
        start = BodyState(0.0, (0.0, 0.0, 0.0), attitude_rad=(0.0, 0.0, HEADING_RAD))
        self.autopilot = SimAutopilot(flavour, theirs, start)
        self._time_s = 0.0

    def flight(self) -> tuple[SimulatedFlight, list[str]]:
        """Fly once to the end; return the flight and what its display said."""
        told = scenario()
        settings, clock = load_settings(base=base_settings(told)), SimulatedClock()
        ends = self._transport, MemoryTransport.pair()[1]
        extras = FlightOptions(vision=VisionSource.TRUTH)
        flight = SimulatedFlight(World(told), settings, EXTERNAL, clock, ends, extras)
        began_s, lines = self._time_s, []

        def physics(now_s: float) -> None:
            self._time_s = began_s + now_s
            self.autopilot.step(self._time_s)

        def show() -> None:
            lines.append(flight.status().phase)
            flight.check_answered()

        fly_lockstep(flight, clock, show, physics=physics)
        return flight, lines


def check_pursuit(flight: SimulatedFlight) -> None:
    """The scenario began where and when it says, and was flown."""
    assert flight.chosen_s is not None
    first = next(sample for sample in flight.truth if sample.time_s > flight.chosen_s)
    assert first.vehicle.position_m[:2] == pytest.approx(START, abs=0.2)
    assert abs(first.vehicle.yaw_rad) < math.radians(2)
    assert first.target_position_m[:2] == pytest.approx((0.0, 3.0), abs=0.01)
    assert flight.truth[-1].target_position_m[0] > 15.0
    stopped_s = next(e.time_s for e in flight.log.events if "stop requested" in e.text)
    assert stopped_s - flight.chosen_s == pytest.approx(DURATION_S, abs=0.05)
    share = flight.score().following_share
    assert share is not None
    assert share > 0.95
    late = [sample for sample in flight.truth if stopped_s - 1 < sample.time_s < stopped_s]
    assert max(sample.range_m for sample in late) < 20
    assert max(abs(sample.azimuth_rad) for sample in late) < math.radians(10)
    assert flight.score().wrong_box_share == 0
    assert flight.phase is AutonomyPhase.DONE


@pytest.mark.slow
@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_late_autopilot_flies_twice_from_its_own_origin_and_heading(flavour: str) -> None:
    elsewhere = Elsewhere(flavour)
    elsewhere.autopilot.health.settled_s, elsewhere.autopilot.health.fit_s = 5.0, 8.0
    first, said = elsewhere.flight()
    assert first.chosen_s is not None
    assert first.chosen_s > 8.0
    assert "connecting: the estimator has no position yet" in said
    refused = elsewhere.autopilot._controller.firmware.unfit_text[:50]
    assert f"arming: {refused}" in said
    check_pursuit(first)
    check_waiting(first)
    check_control(first)
    assert elsewhere.autopilot.armed
    assert elsewhere.autopilot.mode in ("LOITER", "BRAKE")

    before = elsewhere.autopilot.state
    assert math.hypot(*before.position_m[:2]) > 8
    if flavour == "ardupilot":
        elsewhere.autopilot.switch_mode("GUIDED")  # as a run that was killed leaves it
    second, said = elsewhere.flight()
    assert second.chosen_s is not None
    assert second.chosen_s < 4.0
    assert str(AutonomyPhase.TAKING_OFF) not in said
    check_pursuit(second)


def check_waiting(flight: SimulatedFlight) -> None:
    """Before it was in the air nothing moved, and the vehicle stood at the start."""
    waiting = [s for s in flight.truth if s.time_s < (flight.chosen_s or 0.0)]
    assert {tuple(round(x, 6) for x in s.target_position_m[:2]) for s in waiting} == {(0.0, 3.0)}
    assert {s.target_velocity_m_s for s in waiting} == {(0.0, 0.0, 0.0)}
    assert all(math.dist(s.vehicle.position_m[:2], START) < 0.1 for s in waiting)
    assert max(-s.vehicle.position_m[2] for s in waiting) == pytest.approx(8.0, rel=0.1)


def check_control(flight: SimulatedFlight) -> None:
    """Control flew in the autopilot's own world."""
    first = next(r for r in flight.log.controls if r.state is SupervisorState.FOLLOWING)
    assert first.vehicle.attitude.yaw_rad == pytest.approx(HEADING_RAD, abs=0.1)


class Told:
    """A link to an autopilot of which a test says what it told."""

    def __init__(self) -> None:
        self.state = VehicleState()
        self.connected = False
        self.altitude_msl_m: float | None = None
        self.problem = ""

    def status(self, _now_s: float) -> LinkStatus:
        return LinkStatus("pymavlink", problem=self.problem)


ATTITUDE = Attitude(0.0, 0.0, HEADING_RAD, 0.0, 0.0, 0.0, 0.0)
POSITION = LocalPosition(40.0, -7.0, -9.0, 0.0, 2.0, 0.0, 0.0)


def test_who_does_not_answer_is_given_up_soon_and_one_whose_estimator_settles_late() -> None:
    told = Told()
    wait = AutopilotWait(cast(Link, told), FlightLog())
    wait.check(AutonomyPhase.CONNECTING, 14.9)
    with pytest.raises(ConnectionFailedError, match="no autopilot answered within 15 s"):
        wait.check(AutonomyPhase.CONNECTING, 15.1)
    told.connected, told.state = True, VehicleState(attitude=ATTITUDE)
    assert wait.words(AutonomyPhase.CONNECTING) == "connecting: the estimator has no position yet"
    wait.check(AutonomyPhase.CONNECTING, 10.0)
    wait.check(AutonomyPhase.CONNECTING, 99.9)
    with pytest.raises(ConnectionFailedError, match="the estimator has no position yet"):
        wait.check(AutonomyPhase.CONNECTING, 100.1)
    told.problem = "several vehicles send heartbeats"
    with pytest.raises(ConnectionFailedError, match="several vehicles"):
        wait.check(AutonomyPhase.CONNECTING, 10.0)


def test_one_that_refuses_to_arm_is_quoted_and_given_up_late() -> None:
    told, log = Told(), FlightLog()
    told.connected, told.altitude_msl_m = True, 500.0
    told.state = VehicleState(attitude=ATTITUDE, position=POSITION)
    wait = AutopilotWait(cast(Link, told), log)
    assert wait.words(AutonomyPhase.ARMING) == "arming"
    log.note(0.0, "autopilot", "Arm: Need Position Estimate")
    log.note(0.0, "autopilot", "MAV_CMD_COMPONENT_ARM_DISARM: MAV_RESULT_FAILED")
    log.note(0.0, "autopilot", "ATTITUDE comes at 4.0 Hz, not at 100; asking again")
    assert wait.words(AutonomyPhase.ARMING) == "arming: Arm: Need Position Estimate"
    wait.check(AutonomyPhase.ARMING, 30.0)
    log.note(31.0, "autonomy", "taking off")
    assert wait.words(AutonomyPhase.TAKING_OFF) == "taking off"
    log.note(32.0, "autopilot", "Takeoff denied")
    wait.check(AutonomyPhase.TAKING_OFF, 209.0)
    with pytest.raises(ConnectionFailedError, match="taking off: Takeoff denied"):
        wait.check(AutonomyPhase.TAKING_OFF, 211.0)
    wait.check(AutonomyPhase.AIRBORNE, 999.0)
    wait.check(None, 999.0)
    assert wait.words(None) == ""


def test_a_picture_that_comes_late_shows_what_was_told_when_it_was_taken() -> None:
    """The vehicle flies north at 4 m/s, stops at once at 1 s, and turns from then on."""
    told = Told()
    vehicle = TelemetryVehicle(cast(Link, told), BodyState(0.0, (0.0, 0.0, 0.0)))
    facing_north = replace(ATTITUDE, yaw_rad=0.0)
    for step in range(51):
        now_s = 0.04 * step
        north_m, speed_m_s = 4 * min(now_s, 1.0), 4.0 if now_s < 1.0 else 0.0
        turn = max(now_s - 1.0, 0.0)
        told.state = VehicleState(
            attitude=replace(facing_north, yaw_rad=turn, yaw_rate_rad_s=1.0, time_s=now_s),
            position=LocalPosition(north_m, 0.0, -9.0, speed_m_s, 0.0, 0.0, now_s),
        )
        vehicle.state_at(now_s)
        if step == 0:
            vehicle.place()
    for late_s in (0.0, 0.15, 0.5, 1.0, 1.5):
        seen = vehicle.state_at(2.0 - late_s)
        assert seen.position_m[0] == pytest.approx(4 * min(2.0 - late_s, 1.0), abs=0.01)
        assert seen.yaw_rad == pytest.approx(max(1.0 - late_s, 0.0), abs=0.05)
    assert vehicle.state.position_m[0] == pytest.approx(4.0)


def test_the_rigid_motion_takes_place_heading_and_velocity_to_the_start() -> None:
    told = Told()
    parked = BodyState(0.0, (*START, 0.0), attitude_rad=(0.0, 0.0, math.radians(-170)))
    vehicle = TelemetryVehicle(cast(Link, told), parked)
    vehicle.place()  # nothing is known yet
    assert vehicle.state is parked
    told.state = VehicleState(attitude=ATTITUDE, position=POSITION)
    vehicle.place()
    ahead_m = 10.0 * math.cos(HEADING_RAD), 10.0 * math.sin(HEADING_RAD)
    moved = replace(
        POSITION,
        north_m=POSITION.north_m + ahead_m[0],
        east_m=POSITION.east_m + ahead_m[1],
        north_m_s=math.cos(HEADING_RAD),
        east_m_s=math.sin(HEADING_RAD),
    )
    turned = replace(ATTITUDE, yaw_rad=HEADING_RAD - math.radians(30))
    told.state = VehicleState(attitude=turned, position=moved)
    nose = math.cos(parked.yaw_rad), math.sin(parked.yaw_rad)
    state = vehicle.state_at(0.0)
    goal = START[0] + 10 * nose[0], START[1] + 10 * nose[1], -9.0
    assert state.position_m == pytest.approx(goal)
    assert state.velocity_m_s == pytest.approx((*nose, 0.0))
    assert state.yaw_rad == pytest.approx(math.radians(160))
