"""The target's place as it is told to autopilots, against the simulator's truth."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.settings import load_settings
from follower.settings.ui import GroundStationSettings, TargetMessage
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import VisionSource
from follower.simulation.runners import fly_lockstep
from follower.ui.ground_station.camera_messages import Endpoint
from follower.ui.ground_station.flight_view import target_place
from follower.ui.ground_station.server import TargetReport
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.state import Origin
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock

MakeRig = Callable[..., Any]
EARTH_M = 6_371_000.0
START_M = np.array((-18.0, 0.0, 0.0))
RATE_HZ = 5.0
BY = {
    "ground": {"range_from": "ground", "target_middle_m": 0.7},
    "size": {"range_from": "size"},
}


def scenario(by: str) -> Scenario:
    servo = {"distance_m": 14.0, "target_size_m": 2.2, "elevation_deg": -25, **BY[by]}
    return Scenario.model_validate(
        {
            "name": "test",
            "title": "A car on a meadow.",
            "duration_s": 20,
            "seed": 3,
            "targets": [
                {
                    "kind": "car",
                    "colour": "#e0401c",
                    "path": {
                        "points": [[0, 0], [30, 0], [50, 20], [50, 60]],
                        "speeds": [{"at_s": 8, "speed_m_s": 3.5, "acceleration_m_s2": 1.0}],
                    },
                }
            ],
            "camera": {"width": 320, "height": 240, "fov_deg": 90, "pitch_deg": -14, "rate_hz": 15},
            "start": {"at": START_M[:2].tolist(), "heading_deg": 0.0},
            "takeoff_height_m": 8,
            "select": {"colour": "#e0401c"},
            "follow": {"servo": servo},
        }
    )


class Told:
    """A flight on a simulated clock, with all that is told of its target."""

    def __init__(self, by: str, flavour: str) -> None:
        wanted, self.clock = scenario(by), SimulatedClock()
        settings = load_settings(base=base_settings(wanted))
        self.flight = SimulatedFlight(
            World(wanted),
            settings,
            flavour,
            self.clock,
            MemoryTransport.pair(),
            FlightOptions(vision=VisionSource.TRUTH),
        )
        self.messages: list[tuple[float, Any]] = []
        self.places: list[tuple[float, Any]] = []
        self.altitude_m = math.nan
        self.origin: Any = None
        decoder = mavlink.MAVLink(None)

        def take(data: bytes) -> None:
            self.messages.append((self.clock.now(), decoder.decode(bytearray(data))))

        ground = GroundStationSettings(target=TargetMessage.BOTH, target_rate_hz=RATE_HZ)
        self.report = TargetReport(ground, Endpoint(250, 191, take), self.flight.view)
        fly_lockstep(self.flight, self.clock, self._each)
        self._times = np.array([one.time_s for one in self.flight.truth])

    def _each(self) -> None:
        now_s, view = self.clock.now(), self.flight.view
        step = view.step(now_s)
        if step is None or step.state is not SupervisorState.FOLLOWING:
            return
        self.report.step(now_s)
        place = target_place(view, now_s)
        if place is not None:
            self.places.append((now_s, place))
        self.origin = step.vehicle.origin

    def truth(self, time_s: float) -> tuple[Any, Any]:
        """Return the target's true position and velocity, from where the vehicle started."""
        sample = self.flight.truth[int(np.argmin(np.abs(self._times - time_s)))]
        return np.array(sample.target_position_m) - START_M, np.array(sample.target_velocity_m_s)


@pytest.fixture(scope="module", params=[("ground", "px4"), ("size", "ardupilot")], ids="-".join)
def told(request: pytest.FixtureRequest) -> Told:
    return Told(*request.param)


@pytest.mark.slow
def test_the_errors_are_as_large_as_the_covariance_says(told: Told) -> None:
    """The squared errors in the covariance's own measure have a mean of 1 if it is right.

    It has to cover what lasts for a while (a box that is not quite the target), so that it may be
    too careful, by ten times in the variance, but not bolder than twice.
    """
    positions, velocities = [], []
    for _, place in told.places:
        fix = place.fix
        true_position, true_velocity = told.truth(fix.time_s)
        off, drift = fix.position_m - true_position, fix.velocity_m_s - true_velocity
        positions.append(off @ np.linalg.solve(fix.covariance[:3, :3], off) / 3)
        velocities.append(drift @ np.linalg.solve(fix.covariance[3:, 3:], drift) / 3)
    assert len(positions) > 60
    assert 0.1 < np.mean(positions) < 2.0
    assert 0.005 < np.mean(velocities) < 2.0
    assert np.percentile(positions, 95) < 2.6, "chi-squared with 3 degrees of freedom, over 3"
    assert np.percentile(velocities, 95) < 2.6


@pytest.mark.slow
def test_what_is_told_is_where_the_target_is(told: Told) -> None:
    follow = [(at, one) for at, one in told.messages if one.get_type() == "FOLLOW_TARGET"]
    assert len(follow) / (follow[-1][0] - follow[0][0]) == pytest.approx(RATE_HZ, rel=0.15)
    for _, one in follow:
        true_position, true_velocity = told.truth(one.timestamp / 1000)
        north = math.radians(one.lat * 1e-7 - told.origin.latitude_deg) * EARTH_M
        level = EARTH_M * math.cos(math.radians(told.origin.latitude_deg))
        east = math.radians(one.lon * 1e-7 - told.origin.longitude_deg) * level
        horizontal = one.position_cov[0]
        assert math.hypot(north - true_position[0], east - true_position[1]) < 4 * horizontal
        assert np.linalg.norm(one.vel - true_velocity) < 12.0
        assert one.est_capabilities == 0b11
    assert all(one.get_srcSystem() == 250 for _, one in told.messages)
    global_position = [one for _, one in told.messages if one.get_type() == "GLOBAL_POSITION_INT"]
    assert len(global_position) == len(follow)
    for (_, one), other in zip(follow, global_position, strict=True):
        assert (one.lat, one.lon) == (other.lat, other.lon)
        assert other.alt == pytest.approx(1000 * one.alt, abs=1)
        assert [other.vx, other.vy] == pytest.approx([100 * v for v in one.vel[:2]], abs=1)


def test_nothing_is_told_without_a_place(make_rig: MakeRig) -> None:
    rig = make_rig(target=TargetMessage.BOTH)
    peer = rig.peer()
    rig.everybody.append(peer)
    rig.run(2.0)
    assert not peer.of("FOLLOW_TARGET")
    assert not peer.of("GLOBAL_POSITION_INT")


def test_an_origin_puts_local_places_on_the_globe() -> None:
    """A degree of latitude is a 360th of the mean circumference; of longitude, half at 60 deg."""
    degree_m = 2 * math.pi * 6_371_000.0 / 360
    assert Origin(60.0, 10.0).geolocated(degree_m, 0.0) == pytest.approx((61.0, 10.0))
    assert Origin(60.0, 10.0).geolocated(0.0, -degree_m) == pytest.approx((60.0, 8.0))
