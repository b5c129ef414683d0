"""What the vision stage promises whatever tracker it has."""

import math
from pathlib import Path

import numpy as np
import pytest

from follower.flight.log import FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.flight.threads import VisionLoop
from follower.flight.vision.stage import OUT_OF_ORDER, VisionStage
from follower.settings.settings import Settings
from follower_vision.clock import SimulatedClock
from follower_vision.fusion import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.correlation import CorrelationTracker
from follower_vision.trackers.registry import make_tracker
from follower_vision.trackers.track import Track, TrackState

BOX = Box(80, 60, 20, 20)


def frame(number: int, time_s: float) -> Frame:
    image = np.random.default_rng(number).integers(0, 60, (120, 160, 3), np.uint8)
    image[50:70, 70:90] = (20, 60, 220)
    image[55:65, 75:85] = (220, 200, 20)
    return Frame(image, time_s, number)


@pytest.mark.parametrize("early_s", [0.35, 0.4, -60.0, math.nan])
def test_a_frame_that_is_not_newer_is_no_sighting(early_s: float) -> None:
    stage = VisionStage(FusionTracker(CorrelationTracker()))
    stage.select(lambda _: BOX)
    for number in range(5):
        seen = stage.step(frame(number, 0.1 * number))
    assert seen.state is TrackState.TRACKING

    track = stage.step(frame(5, early_s))
    assert (track.state, track.produced_by) == (TrackState.COASTING, OUT_OF_ORDER)
    assert (track.box, track.confidence) == (seen.box, 0.0)

    track = stage.step(frame(6, 0.6))
    assert track.state is TrackState.TRACKING


def test_a_target_is_not_chosen_in_a_frame_from_the_past() -> None:
    stage = VisionStage(FusionTracker(CorrelationTracker()))
    assert stage.step(frame(0, 1.0)) is None
    stage.select(lambda _: BOX)
    assert stage.step(frame(1, 0.5)) is None
    assert stage.chosen is None
    assert stage.step(frame(2, 1.1)) is not None
    assert stage.chosen == BOX


def test_a_choice_made_while_another_one_is_searched_for_is_not_lost() -> None:
    stage, other = VisionStage(FusionTracker(CorrelationTracker())), BOX.moved_to(30, 30)

    def searched(_: Frame) -> Box:
        stage.select(lambda _: other)  # as from another thread
        return BOX

    stage.select(searched)
    stage.step(frame(0, 0.0))
    assert stage.chosen == BOX
    stage.step(frame(1, 0.1))
    assert stage.chosen == other
    stage.step(frame(2, 0.2))
    assert stage.chosen is None


def test_another_target_in_place_of_the_one_followed_is_counted_the_same_one_is_not() -> None:
    stage = VisionStage(FusionTracker(CorrelationTracker()))
    boxes = [BOX, BOX.moved_to(84, 60), BOX.moved_to(30, 30), BOX]
    counted = []
    for number, box in enumerate(boxes):
        stage.select(lambda _, box=box: box)
        stage.step(frame(number, 0.1 * number))
        counted.append(stage.replaced)
    assert counted == [0, 0, 1, 2]
    assert stage.requests_done == 0


def test_a_box_that_the_tracker_cannot_follow_is_refused_and_vision_goes_on() -> None:
    requests = OperatorRequests(Settings())
    stage = VisionStage(FusionTracker(make_tracker("mil", Path)), requests)
    stage.select(lambda _: BOX)
    assert stage.step(frame(0, 0.0)) is not None
    asked = requests.select_rectangle(0.5, 0.0, 0.6, 1.0, "test")  # MIL needs image around it
    assert stage.step(frame(1, 0.1)) is None
    assert not asked.outcome.accepted
    assert "mil" in asked.outcome.text
    assert stage.dropped
    again = requests.select_rectangle(70 / 160, 50 / 120, 90 / 160, 70 / 120, "test")
    assert stage.step(frame(2, 0.2)) is not None
    assert again.outcome.accepted


def test_what_fails_in_a_frame_with_another_request_is_not_laid_to_the_operator() -> None:
    class Failing(FusionTracker):
        def step(self, frame: Frame) -> Track:
            raise ValueError(f"frame {frame.sequence}: operands could not be broadcast")

    requests = OperatorRequests(Settings())
    stage = VisionStage(Failing(CorrelationTracker()), requests)
    stage.select(lambda _: BOX)
    stage.step(frame(0, 0.0))
    asked = requests.select_rectangle(0.5, 0.5, 0.501, 0.501, "test")  # too small: refused
    with pytest.raises(ValueError, match="broadcast"):
        stage.step(frame(1, 0.1))
    assert asked.outcome is None
    assert not stage.dropped


def test_what_ends_vision_is_told_while_the_flight_goes_on() -> None:
    log = FlightLog()
    stage = VisionStage(FusionTracker(make_tracker("mil", Path)))
    vision = VisionLoop(stage, SimulatedClock(), log)
    stage.select(lambda _: Box(80, 60, 16, 120))
    with pytest.raises(ValueError, match="mil"):
        vision.step(frame(0, 0.0))
    (event,) = log.events
    assert event.source == "vision"
    assert event.text.startswith("failed: ValueError: OpenCV's mil tracker")
