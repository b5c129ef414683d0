"""Control tells vision where in the next image the target can be: it holds, and it replays."""

import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from follower.apps.replay.comparison import compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.flight.log import TrackRecord
from follower.flight.vision.stage import VisionStage
from follower.recording import open_flight
from follower.settings.settings import find_scenario
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.options import SimulationOptions, VisionSource, simulation_settings
from follower.simulation.run import simulate
from follower.simulation.runners import fly_lockstep
from follower_control.common.transport import MemoryTransport
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import ServoSettings
from follower_control.target.estimator import TargetEstimator
from follower_control.target.observation import BearingFrame, BearingObservation
from follower_control.target.settings import EstimatorSettings
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box, lies_in
from follower_vision.geometry.line_of_sight import LineOfSight
from follower_vision.images.frame import Frame
from follower_vision.trackers.target_tracker import TargetPrediction
from follower_vision.trackers.track import Track, TrackState

BOX = Box(80, 60, 20, 20)
FAR = TargetPrediction(500.0, 100.0, Box(500, 100, 40, 40), Box(500, 100, 80, 80))


def frame(number: int, time_s: float) -> Frame:
    return Frame(np.zeros((120, 160, 3), np.uint8), time_s, number)


class Told:
    """A tracker that sees nothing, and notes what it was told before each frame."""

    def __init__(self) -> None:
        self.told: list[TargetPrediction | None] = []

    def start(self, frame: Frame, box: Box) -> Track:
        return Track(box, TrackState.TRACKING, 1.0, "told", frame.captured_s, frame.sequence)

    def expect(self, prospect: TargetPrediction | None) -> None:
        self.told.append(prospect)

    def step(self, frame: Frame) -> Track:
        return Track(BOX, TrackState.LOST, 0.0, "told", frame.captured_s, frame.sequence)


def test_a_tracker_is_told_before_each_frame_but_the_one_in_which_it_starts() -> None:
    tracker, asked = Told(), []

    def prospects(captured_s: float, requests: int) -> TargetPrediction | None:
        asked.append((captured_s, requests))
        return FAR if captured_s < 0.25 else None

    stage = VisionStage(tracker)
    stage.prospects = prospects
    stage.step(frame(0, 0.0))
    stage.select(lambda _: BOX)
    for number in range(1, 5):
        stage.step(frame(number, 0.1 * number))
        assert stage.prospect == (FAR if number == 2 else None)
    assert tracker.told == [FAR, None, None]
    assert asked == [(pytest.approx(0.1 * number), 0) for number in (2, 3, 4)]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pursue-car", "pursue-person", "pursue-quadrotor"])
def test_a_hidden_target_is_where_it_is_said_to_be(name: str) -> None:
    """Whatever it does below a canopy; and it is no large part of the image."""
    scenario = load_scenario(find_scenario(name), ("duration_s=45", "occlusions.hidden_s=3"))
    world, clock = World(scenario, 5), SimulatedClock()
    flight = SimulatedFlight(
        world,
        simulation_settings(scenario),
        "px4",
        clock,
        MemoryTransport.pair(),
        FlightOptions(vision=VisionSource.TRUTH),
    )
    truth, asked = GroundTruth(world), []
    look = flight.vision.step

    def step(frame: Frame, delay_s: float = 0.0) -> TrackRecord:
        captured_s = frame.captured_s
        true_s = captured_s - scenario.camera.stamp_offset_s
        seen = truth.seen(true_s, flight.vehicle.state_at(true_s))
        asked.append((seen, flight.stage.prospect(captured_s, 0)))
        return look(frame, delay_s)

    flight.vision.step = step  # type: ignore[method-assign]
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    told = [(seen, prospect) for seen, prospect in asked if prospect is not None and seen.box]
    hidden = [(seen, prospect) for seen, prospect in told if seen.visible_share < 0.1]
    assert len(told) > 500
    assert len(hidden) > 25
    possible = [lies_in(seen.box, one.possible) for seen, one in told]
    assert sum(possible) >= 0.995 * len(told)
    likely = [lies_in(seen.box, one.likely, seen.box.scale / 4) for seen, one in hidden]
    assert sum(likely) >= 0.9 * len(hidden)
    area = scenario.camera.width * scenario.camera.height
    plain = [one.possible.area / area for seen, one in told if seen.visible_share > 0.9]
    assert sorted(plain)[len(plain) // 2] < 0.1


def test_nothing_is_foreseen_of_a_target_that_has_long_been_gone() -> None:
    """It can be on any side of us by then, and no region of the image says that."""
    servo = VisualServo(ServoSettings(target_size_m=1.0, distance_m=10.0))
    estimator, gone_s = TargetEstimator(EstimatorSettings(restart_after_s=20.0)), 2.0
    servo.start()
    for number in range(600):
        now_s = 0.02 * number
        if now_s < gone_s:
            sight = LineOfSight(0.0, -0.3)
            estimator.observe(
                BearingObservation(sight, math.log(0.1), now_s, BearingFrame.WORLD, False)
            )
        estimate = estimator.estimate(now_s)
        attitude = Attitude(0, 0, 0, 0, 0, 0, now_s)
        position = LocalPosition(0, 0, -5, 0, 0, 0, now_s)
        assert estimate is not None
        servo.update(estimate, VehicleState(attitude, position, "OFFBOARD", True, True), HOLD)
        if 1.0 < now_s < gone_s + 5.0:
            outlook = servo.pursuit.predicted_region(now_s)
            assert outlook.away_m[0] > 5
        if now_s > gone_s + 6.1:
            assert servo.pursuit.predicted_region(now_s) is None


@pytest.mark.slow
def test_what_vision_was_told_is_recorded_and_replays_bit_for_bit(tmp_path: Path) -> None:
    options = SimulationOptions(
        "pursue-person",
        lockstep=True,
        seed=3,
        out=tmp_path,
        video=False,
        overrides=("tracker=re3", "detector=embedded", "recorder.video=lossless"),
        scene=("duration_s=11",),
    )
    simulate(options)
    flight = open_flight(tmp_path / "pursue-person")
    told = [record for record in flight.log.tracks if record.prospect is not None]
    assert len(told) > 60
    compared = compare(flight.log, Replay(flight, replay_settings(flight)).run())
    assert compared.identical, [one.name for one in compared.differing]
