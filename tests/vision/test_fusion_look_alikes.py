"""Fusion in a flight looks for its target's look-alikes, and takes none of them for it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from told_trackers import BOX, LEVEL, ToldDetector, ToldMotion, Trackers, foreseen, frame, seen

from follower_vision.detection.detectors import parts
from follower_vision.fusion.tracker import AMBIGUOUS
from follower_vision.geometry.camera_model import CameraView
from follower_vision.trackers.track import Track, TrackState

OTHER = BOX.moved_to(160, 120)


def pursued(fusion: Trackers, motion: ToldMotion, view: CameraView | None) -> list[Track]:
    """A target that hides for half a second while its look-alike passes where it should be.

    Both were seen before by the detector, the motion tracker saw the target.
    """
    detector = ToldDetector()
    detector.sees = [seen(BOX), seen(OTHER)]
    tracker, tracks = fusion(detector), []
    tracker.start(frame(0), BOX)
    for number in range(1, 46):
        shown = number <= 30
        motion.sights = [(BOX, 1.0)] if shown else [(OTHER, 0.62 * (number > 35)), (BOX, 0.0)]
        detector.sees = [seen(BOX), seen(OTHER)] if shown else []
        tracker.expect(replace(foreseen(BOX, 300.0), range_m=5.0, view=view))
        tracks.append(tracker.step(frame(number)))
    return tracks


def test_a_look_alike_that_was_seen_beside_the_target_is_not_taken_for_it(
    fusion: Trackers, motion: ToldMotion
) -> None:
    nobody_remembers = pursued(fusion, motion, None)
    assert nobody_remembers[-1].state is TrackState.TRACKING
    assert nobody_remembers[-1].box.iou(OTHER) > 0.9
    remembered = pursued(fusion, motion, LEVEL)
    assert all(one.state is TrackState.TRACKING for one in remembered[:30])
    hidden = remembered[35:]
    assert all(one.state is not TrackState.TRACKING for one in hidden)
    assert {one.produced_by for one in hidden} == {AMBIGUOUS}
    assert max(one.confidence for one in hidden) < 0.5


def test_where_flights_tell_of_the_world_the_detector_also_looks_for_look_alikes(
    fusion: Trackers, motion: ToldMotion
) -> None:
    for view in (None, LEVEL):
        detector = ToldDetector()
        detector.sees = [seen(BOX)]
        tracker = fusion(detector)
        tracker.start(frame(0), BOX)
        for number in range(1, 70):
            tracker.expect(replace(foreseen(BOX), range_m=20.0, view=view))
            motion.sights = [(BOX, 1.0)]
            tracker.step(frame(number))
        looks = detector.regions[3:]
        about = [one for one in looks if one is not None and one.distance(BOX) < BOX.scale]
        others = {one for one in looks if one not in about}
        if view is None:
            assert not others
        else:
            assert others == set(parts(320, 240)), "all of the image in turn"
            assert len(about) == pytest.approx(len(looks) / 2, abs=1)
