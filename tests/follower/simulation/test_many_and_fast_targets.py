"""Four targets of which the operator hands one to the other, and one that no vehicle catches."""

import math
from typing import Any

import numpy as np
import pytest

from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.target.request import TargetRequest
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import VisionSource, simulation_settings
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_control.envelope.envelope import Limit
from follower_sim.scenario.scenario import Scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import TrackState

pytestmark = pytest.mark.slow

COLOURS = "#e0401c", "#2a62c8", "#101014", "#e0b020"
WIDTH, HEIGHT = 320, 240


def driving(path: dict[str, Any], colour: str = COLOURS[0]) -> dict[str, Any]:
    return {"kind": "car", "colour": colour, "path": path}


def scenario(targets: list[dict[str, Any]], duration_s: float, **more: Any) -> Scenario:
    data = {
        "name": "test",
        "title": "Cars on a meadow.",
        "duration_s": duration_s,
        "targets": targets,
        "camera": {
            "fov_deg": 90,
            "pitch_deg": -20,
            "rate_hz": 15,
            "width": WIDTH,
            "height": HEIGHT,
        },
        "start": {"at": [-15, 0]},
        "select": {"colour": COLOURS[0], "search": {"max_growth_ratio": 0.1}},
    }
    return Scenario.model_validate(data | more)


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_a_target_beyond_the_speed_limit_gets_away_steadily_in_view_and_the_log_says_why(
    flavour: str,
) -> None:
    most, target = 5.0, 8.0
    speeds = [{"at_s": 14, "speed_m_s": target, "acceleration_m_s2": 2.0}]
    path = {"points": [[0, 0], [300, 0]], "speeds": speeds}
    servo = {"distance_m": 14, "range_from": "ground", "elevation_deg": -25}
    follow = {"envelope": {"max_speed_m_s": most, "fence_radius_m": 600}, "servo": servo}
    wanted = scenario([driving(path)], 45, follow=follow)
    clock, extras = SimulatedClock(), FlightOptions(vision=VisionSource.TRUTH)
    settings, ends = simulation_settings(wanted), MemoryTransport.pair()
    flight = SimulatedFlight(World(wanted), settings, flavour, clock, ends, extras)
    fly_lockstep(flight, clock, lambda: None)
    flight.close()
    chased = [one for one in flight.truth if 25 < one.time_s < 44.5]
    ahead = [one.target_position_m[0] - one.vehicle.position_m[0] for one in chased]
    times = [one.time_s for one in chased]
    rate, start = np.polyfit(times, ahead, 1)
    speeds = [math.hypot(*one.vehicle.velocity_m_s[:2]) for one in chased]
    assert rate == pytest.approx(target - most, abs=0.3)
    assert np.abs(np.polyval((rate, start), times) - ahead).max() < 2
    assert 0.9 * most < min(speeds) <= max(speeds) < 1.05 * most
    assert min(one.in_frame_share for one in chased) == 1
    records = [one for one in flight.log.controls if 25 < one.time_s < 44.5]
    assert {one.state for one in records} == {SupervisorState.FOLLOWING}
    assert np.mean([Limit.SPEED in one.limits for one in records]) > 0.95


class Operator:
    """Clicks on what is to be followed, and notes which car the box is on, frame by frame."""

    def __init__(self, flight: SimulatedFlight, clicks: dict[float, int | None]) -> None:
        self._flight, self._waiting = flight, dict(clicks)
        worlds = [World(flight.scenario.model_copy(update={"followed": n})) for n in range(4)]
        self._truths = [GroundTruth(world) for world in worlds]
        self._answered = -1
        self.followed: list[tuple[float, int | None]] = []
        self.requests: list[TargetRequest] = []

    def boxes(self, time_s: float) -> list[Box | None]:
        body = self._flight.vehicle.state_at(time_s)
        return [truth.seen(time_s, body).box for truth in self._truths]

    def look(self) -> None:
        """Act at the newest frame."""
        records = self._flight.log.tracks
        if not records or records[-1].sequence == self._answered:
            return
        newest, self._answered = records[-1], records[-1].sequence
        boxes = self.boxes(newest.captured_s)
        if newest.track is not None and newest.track.state is TrackState.TRACKING:
            mine = newest.track.box
            overlaps = [0.0 if box is None else mine.iou(box) for box in boxes]
            best = int(np.argmax(overlaps))
            which = best if overlaps[best] > 0.2 else None
            self.followed.append((newest.captured_s, which))
        for due_s in [due_s for due_s in self._waiting if newest.captured_s >= due_s]:
            self.requests.append(self.click(boxes, self._waiting.pop(due_s)))

    def click(self, boxes: list[Box | None], number: int | None) -> TargetRequest:
        """Click once: on a car, or on nothing at all."""
        box = Box(8, HEIGHT - 8, 4, 4) if number is None else boxes[number]
        return self._flight.requests.select_point(box.cx / WIDTH, box.cy / HEIGHT, "operator")

    def during(self, from_s: float, until_s: float) -> set[int | None]:
        return {which for time_s, which in self.followed if from_s < time_s < until_s}


def test_one_click_hands_over_to_another_of_four_targets_and_back_and_no_other_is_taken() -> None:
    speeds = [{"at_s": 8, "speed_m_s": 1.5, "acceleration_m_s2": 1.0}]
    lanes = [{"points": [[0, east], [60, east]], "speeds": speeds} for east in (-9, -3, 3, 9)]
    targets = [driving(lane, colour) for lane, colour in zip(lanes, COLOURS, strict=True)]
    servo = {"distance_m": 16, "range_from": "ground", "elevation_deg": -25}
    wanted = scenario(targets, 27, follow={"servo": servo}, takeoff_height_m=7)
    clock, settings = SimulatedClock(), simulation_settings(wanted)
    ends = MemoryTransport.pair()
    flight = SimulatedFlight(World(wanted), settings, "px4", clock, ends)
    operator = Operator(flight, {15.0: 2, 19.0: None, 22.0: 0})
    fly_lockstep(flight, clock, operator.look)
    flight.close()
    outcomes = [request.outcome for request in operator.requests]
    assert [outcome is not None and outcome.accepted for outcome in outcomes] == [True, False, True]
    assert operator.during(12, 15) == {0}
    assert operator.during(15.3, 22) == {2}
    assert operator.during(22.3, 26.5) == {0}
    steering = [one for one in flight.log.controls if 12 < one.time_s < 26.5]
    assert {one.state for one in steering} == {SupervisorState.FOLLOWING}
