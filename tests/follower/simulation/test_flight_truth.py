"""The truth beside a flight: what the score is told of the frames."""

from pathlib import Path

import pytest
from small_scenario import small_scenario

from follower.flight.log import TrackRecord
from follower.simulation.ground_truth import FlightTruth
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.world.world import World
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import Track, TrackState


def hovering(time_s: float) -> BodyState:
    return BodyState(time_s, (0.0, 0.0, -6.0))


def test_a_tracked_frame_has_the_truths_time_whatever_its_stamp_says(tmp_path: Path) -> None:
    path = tmp_path / "small.yaml"
    path.write_text(small_scenario(20.0), encoding="utf-8")
    world = World(load_scenario(path, ["camera.stamp_offset_s=0.3"]))
    truth = FlightTruth(world, hovering, hovering)
    track = Track(Box(160.0, 120.0, 20.0, 20.0), TrackState.TRACKING, 1.0, "test", 10.3, 0)
    truth.compare(TrackRecord(track, 0, 10.3, 10.31, 10.32, 0.0))
    assert truth.tracked[0].time_s == pytest.approx(10.0)
