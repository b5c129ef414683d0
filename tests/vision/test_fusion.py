"""What Fusion promises as a target tracker, with a motion tracker and a judge that are written."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from told_trackers import (
    BOX,
    NOISE,
    RATE_HZ,
    HeldDetection,
    ToldDetector,
    ToldMotion,
    Trackers,
    follow,
    foreseen,
    frame,
    going_right,
    seen,
    unseen,
)

from follower_vision.detection.detection_service import (
    DetectionAnswer,
)
from follower_vision.fusion import FusionSettings, FusionTracker
from follower_vision.fusion.candidates import corners_of
from follower_vision.fusion.model import CandidateModel
from follower_vision.fusion.tracker import AMBIGUOUS, Choice
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.correlation import CorrelationTracker
from follower_vision.trackers.track import Track, TrackState


@pytest.fixture
def started(fusion: Trackers) -> Trackers:
    """Make a tracker that was started on BOX in the first frame."""

    def make(*parts: object, **more: object) -> FusionTracker:
        tracker = fusion(*parts, **more)
        tracker.start(frame(0), BOX)
        return tracker

    return make


@pytest.fixture
def tracker(started: Trackers) -> FusionTracker:
    return started()


def test_it_starts_inside_the_image_and_steps_after_that(fusion: Trackers) -> None:
    tracker = fusion()
    for premature in (tracker.step, tracker.advance, tracker.conclude):
        with pytest.raises(RuntimeError, match="not started"):
            premature(frame(0))
    with pytest.raises(RuntimeError, match="not started"):
        tracker.put_back(BOX)
    with pytest.raises(ValueError, match="outside the image of 320 x 240"):
        tracker.start(frame(0), Box(-100, -100, 20, 20))
    track = tracker.start(frame(0), Box(0, 100, 20, 20))
    assert (track.state, track.confidence) == (TrackState.TRACKING, 1.0)
    assert track.box == Box(0, 100, 20, 20)


def test_it_follows_what_is_seen(tracker: FusionTracker, motion: ToldMotion) -> None:
    sights = going_right(20)
    tracks = follow(tracker, motion, sights)
    for number, (track, ((box, _),)) in enumerate(zip(tracks, sights, strict=True), 1):
        assert track.state is TrackState.TRACKING
        assert track.produced_by == "peak"
        assert track.box.iou(box) == pytest.approx(1.0)
        assert (track.captured_s, track.sequence) == (number / RATE_HZ, number)


@settings(max_examples=30)
@given(likeness=st.lists(st.floats(0, 1), min_size=1, max_size=25))
@example(likeness=[0.0] * 12 + [0.4])
def test_who_tracks_believes_it_and_who_is_lost_does_not(
    judge: CandidateModel, likeness: list[float]
) -> None:
    motion = ToldMotion()
    tracker = FusionTracker(motion, model=judge)
    tracker.start(frame(0), BOX)
    for track in follow(tracker, motion, [[(BOX, one)] for one in likeness]):
        if track.state is TrackState.TRACKING:
            assert track.confidence >= 0.5
            assert track.produced_by == "peak"
        if track.state is TrackState.LOST:
            assert track.confidence < 0.5
        assert 0 <= track.confidence <= 1


def test_a_target_unseen_is_lost_after_0_4_s_and_found_again(
    tracker: FusionTracker, motion: ToldMotion
) -> None:
    tracks = follow(tracker, motion, [*going_right(10), *unseen(20), *going_right(2)])
    states = [track.state for track in tracks]
    coasting = round(0.4 * RATE_HZ)
    assert states == [
        *[TrackState.TRACKING] * 10,
        *[TrackState.COASTING] * coasting,
        *[TrackState.LOST] * (20 - coasting),
        *[TrackState.TRACKING] * 2,
    ]
    assert {track.produced_by for track in tracks[10:30]} == {"prediction"}


def test_a_target_unseen_goes_on_as_it_went_for_a_while(
    tracker: FusionTracker, motion: ToldMotion
) -> None:
    seen_last = follow(tracker, motion, going_right(20))[-1].box
    coasting = [track.box.cx - seen_last.cx for track in follow(tracker, motion, unseen(20), 21)]
    steps = np.diff([0.0, *coasting])
    assert steps[0] == pytest.approx(3.0, abs=0.5)
    assert all(0 < later < earlier for earlier, later in itertools.pairwise(steps))


@pytest.mark.parametrize("kind", ["frozen", "blank"])
def test_frames_that_show_nothing_are_not_searched(
    tracker: FusionTracker, motion: ToldMotion, kind: str
) -> None:
    follow(tracker, motion, going_right(10))
    image = NOISE[10] if kind == "frozen" else np.zeros_like(NOISE[10])
    tracks = [tracker.step(Frame(image, k / RATE_HZ, k)) for k in range(11, 40)]
    searched = len(motion.searched)
    told = [track for track in tracks if track.produced_by == kind]
    assert len(told) >= len(tracks) - 4
    assert told[0].state is TrackState.COASTING
    assert told[-1].state is TrackState.LOST
    assert told[-1].confidence < 0.5
    assert searched == 1 + 10 + len(tracks) - len(told)
    assert follow(tracker, motion, going_right(1), 40)[0].state is TrackState.TRACKING


def test_of_several_the_one_that_is_believed_most_is_taken(
    tracker: FusionTracker, motion: ToldMotion
) -> None:
    other = BOX.moved_to(160, 120)
    (track,) = follow(tracker, motion, [[(other, 0.7), (BOX, 0.8)]])
    assert track.box.distance(BOX) < 1e-9
    (track,) = follow(tracker, motion, [[(other, 0.8), (BOX, 0.45)]], 2)
    assert track.box.distance(other) < 1e-9


def test_what_is_doubtful_is_followed_but_neither_called_seen_nor_learnt(
    tracker: FusionTracker, motion: ToldMotion
) -> None:
    doubtful = Box(BOX.cx + 5, BOX.cy, 1.3 * BOX.width, BOX.height)
    (track,) = follow(tracker, motion, [[(doubtful, 0.49)]])
    assert (track.state, track.produced_by) == (TrackState.COASTING, "peak")
    assert track.box.iou(doubtful) == pytest.approx(1.0), "as it was seen, however doubtful"
    assert motion.learnt == []
    follow(tracker, motion, [[(BOX, 0.9)]], 2)
    assert len(motion.learnt) == 1


def test_the_detector_looks_about_the_target_every_fourth_frame(
    started: Trackers, motion: ToldMotion
) -> None:
    detector = ToldDetector()
    tracker = started(detector)
    follow(tracker, motion, going_right(12))
    assert len(detector.regions) == 1 + 3
    for region in detector.regions:
        assert region.width >= FusionSettings().crop_least_px
        assert region.distance(BOX) < region.width / 4 + 12 * 3


def test_in_doubt_it_looks_every_second_frame(started: Trackers, motion: ToldMotion) -> None:
    detector = ToldDetector()
    tracker = started(detector)
    follow(tracker, motion, [[(BOX, 0.52)]] * 8)
    assert len(detector.regions) == 1 + 4


def test_a_lost_target_is_searched_for_where_something_like_it_was_detected(
    started: Trackers, motion: ToldMotion
) -> None:
    detector, elsewhere = ToldDetector(), Box(250, 60, 20, 30)
    tracker = started(detector)
    detector.sees = [seen(elsewhere, 0.3)]
    follow(tracker, motion, unseen(30))
    assert min(place.distance(elsewhere) for place in motion.searched[-2:]) < 1e-9
    assert min(place.distance(elsewhere) for place in motion.searched[:12]) > 100


def test_a_detection_far_away_finds_the_lost_target_again(
    started: Trackers, motion: ToldMotion
) -> None:
    detector, elsewhere = ToldDetector(), Box(250, 60, 20, 30)
    tracker = started(detector)
    follow(tracker, motion, unseen(20))
    detector.sees = [seen(elsewhere)]
    tracks = follow(tracker, motion, unseen(3), 21)
    found = [track for track in tracks if track.state is TrackState.TRACKING]
    assert {track.produced_by for track in found} == {"detection"}
    assert found[0].box.distance(elsewhere) < 1e-9


def detected(tracker: FusionTracker) -> list[np.ndarray]:
    """The corners of the detections among the candidates, as they come."""
    found: list[np.ndarray] = []

    def note(choice: Choice) -> None:
        places = [k for k, source in enumerate(choice.sources) if source == "detection"]
        found.extend(choice.corners[places])

    tracker.listener = note
    return found


def test_an_answer_that_comes_late_is_moved_along_with_the_target(
    started: Trackers, motion: ToldMotion
) -> None:
    service = HeldDetection()
    tracker = started(ToldDetector(), mode=lambda _: service)
    found = detected(tracker)
    follow(tracker, motion, going_right(4))
    asked = service.requests[-1]
    assert asked.index == 4
    follow(tracker, motion, going_right(10)[4:], 5)
    then = BOX.moved_to(BOX.cx + 4 * 3, BOX.cy)
    service.answers = [DetectionAnswer(asked, [seen(then)])]
    motion.sights = going_right(11)[-1]
    now = tracker.step(frame(11)).box
    ((left, _, right, _),) = found
    true = BOX.cx + 11 * 3
    assert (left + right) / 2 == pytest.approx(true, abs=1.0)
    assert now.cx == pytest.approx(true, abs=0.5)  # the mean of where both say


def test_an_answer_for_a_frame_that_is_forgotten_proposes_and_teaches_nothing(
    started: Trackers, motion: ToldMotion
) -> None:
    service = HeldDetection()
    tracker = started(ToldDetector(), mode=lambda _: service)
    found = detected(tracker)
    follow(tracker, motion, [[(BOX, 1.0)]] * 70)
    asked = next(one for one in service.requests if one.index == 4)
    memory = tracker._started().detector
    before = memory.hits, memory.silence
    service.answers = [DetectionAnswer(asked, [seen(BOX.moved_to(250, 100))])]
    motion.sights = [(BOX, 1.0)]
    assert tracker.step(frame(71)).state is TrackState.TRACKING
    assert found == []
    assert (memory.hits, memory.silence) == before


def test_the_first_answer_may_come_however_late(started: Trackers, motion: ToldMotion) -> None:
    service = HeldDetection()
    tracker = started(ToldDetector(), mode=lambda _: service)
    follow(tracker, motion, [[(BOX, 1.0)]] * 70)
    service.answers = [DetectionAnswer(service.requests[0], [seen(BOX)])]
    assert tracker.step(frame(71)).state is TrackState.TRACKING


def test_an_answer_for_an_earlier_target_is_ignored(started: Trackers, motion: ToldMotion) -> None:
    service = HeldDetection()
    tracker = started(ToldDetector(), mode=lambda _: service)
    found = detected(tracker)
    tracker.start(frame(1), Box(200, 100, 20, 30))
    service.answers = [DetectionAnswer(service.requests[0], [seen(BOX)])]
    follow(tracker, motion, unseen(1), 2)
    assert found == []


def test_what_the_detector_saw_at_the_start_tells_how_its_boxes_differ(
    started: Trackers, motion: ToldMotion
) -> None:
    """The user chose the upper half of what the detector takes for one thing."""
    detector = ToldDetector()
    whole = Box(BOX.cx, BOX.bottom, BOX.width, 2 * BOX.height)
    detector.sees = [seen(whole)]
    tracker = started(detector)
    found = detected(tracker)
    follow(tracker, motion, unseen(4))
    assert found[0] == pytest.approx(corners_of([BOX])[0])


def test_nothing_is_taken_where_the_target_cannot_be(
    tracker: FusionTracker, motion: ToldMotion
) -> None:
    far = BOX.moved_to(260, 120)
    tracker.expect(foreseen(BOX))
    (track,) = follow(tracker, motion, [[(far, 1.0)]])
    assert track.state is TrackState.COASTING
    assert track.box.distance(BOX) < 5
    (track,) = follow(tracker, motion, [[(far, 1.0)]], 2)
    assert track.box.distance(far) < 1e-9, "it holds for one frame"


def test_a_lost_target_is_expected_where_control_says(fusion: Trackers, motion: ToldMotion) -> None:
    told, untold = Box(220, 180, 20, 30), fusion(settings=FusionSettings(target_prediction=False))
    tracker = fusion()
    for one in (tracker, untold):
        one.start(frame(0), BOX)
        follow(one, motion, unseen(20))
        one.expect(foreseen(told, 20.0))
        one.step(frame(21))
    searched, not_told = motion.searched[20 + 1], motion.searched[-1]
    assert searched.distance(told) < 0.2 * BOX.distance(told)
    assert not_told.distance(BOX) < 5


@pytest.mark.parametrize("in_flight", [False, True])
def test_on_video_the_box_is_the_mean_of_those_that_agree(
    tracker: FusionTracker, motion: ToldMotion, in_flight: bool
) -> None:
    """In a flight it is the chosen one's; what is searched for next follows that one in both."""
    beside = BOX.moved_to(BOX.cx + 0.4 * BOX.width, BOX.cy)
    tracker.expect(foreseen(BOX) if in_flight else None)
    (track,) = follow(tracker, motion, [[(BOX, 1.0), (beside, 0.9)]])
    assert track.state is TrackState.TRACKING
    if in_flight:
        assert track.box == BOX
    else:
        assert BOX.cx + 0.5 < track.box.cx < beside.cx - 0.5
    follow(tracker, motion, [[(BOX, 1.0)]], 2)
    assert motion.searched[-1].cx == pytest.approx(BOX.cx, abs=0.5)


@pytest.mark.parametrize("in_flight", [False, True])
def test_in_a_flight_a_lost_target_is_followed_from_the_second_frame_that_shows_it(
    tracker: FusionTracker, motion: ToldMotion, in_flight: bool
) -> None:
    follow(tracker, motion, unseen(20))
    states = []
    for number in (21, 22):
        tracker.expect(foreseen(BOX) if in_flight else None)
        tracks = follow(tracker, motion, [[(BOX, 1.0)]], number)
        states += [one.state for one in tracks]
        assert all(one.produced_by != AMBIGUOUS for one in tracks), "no look-alike is known"
    first = TrackState.LOST if in_flight else TrackState.TRACKING
    assert states == [first, TrackState.TRACKING]


def test_another_trackers_target_is_left_to_it(motion: ToldMotion, judge: CandidateModel) -> None:
    theirs, motion_of_other = BOX.moved_to(130, 120), ToldMotion()
    mine, other = FusionTracker(motion, model=judge), FusionTracker(motion_of_other, model=judge)
    motion_of_other.sights = [(theirs, 1.0)]
    mine.start(frame(0), BOX)
    other.start(frame(0), theirs)
    assert other.sure_box == theirs
    mine.beside([other])
    (track,) = follow(mine, motion, [[(theirs, 1.0)]])
    assert track.state is TrackState.COASTING
    motion_of_other.sights = [(theirs, 0.0)]
    other.step(frame(1))
    assert other.sure_box is None
    (track,) = follow(mine, motion, [[(theirs, 1.0)]], 2)
    assert track.box.distance(theirs) < 1e-9, "nobody says that it sees it"


def test_two_targets_that_overlap_keep_both_their_boxes(
    motion: ToldMotion, judge: CandidateModel
) -> None:
    theirs, motion_of_other = BOX.moved_to(BOX.cx + 4, BOX.cy), ToldMotion()
    mine, other = FusionTracker(motion, model=judge), FusionTracker(motion_of_other, model=judge)
    mine.start(frame(0), BOX)
    other.start(frame(0), theirs)
    mine.beside([other])
    (track,) = follow(mine, motion, [[(BOX, 1.0)]])
    assert track.state is TrackState.TRACKING


def test_put_back_it_goes_on_from_there(tracker: FusionTracker, motion: ToldMotion) -> None:
    place = Box(220, 60, 24, 24)
    follow(tracker, motion, unseen(20))
    tracker.put_back(place)
    assert tracker.sure_box == place
    (track,) = follow(tracker, motion, unseen(1), 21)
    assert track.state is TrackState.COASTING
    assert motion.searched[-1].distance(place) < 1e-9


@pytest.mark.parametrize("interval_s", [1 / 120, 1 / 30, 1 / 8])
def test_the_way_gone_unseen_depends_on_the_time_not_on_the_frames(
    tracker: FusionTracker, motion: ToldMotion, interval_s: float
) -> None:
    speed_px_s, time_s = 30.0, 0.0
    for number in range(1, 41):
        time_s = number * interval_s
        motion.sights = [(BOX.moved_to(BOX.cx + speed_px_s * time_s, BOX.cy), 1.0)]
        before = tracker.step(frame(number, time_s)).box
    motion.sights = [(BOX, 0.0)]
    for number, share in enumerate((0.2, 0.7, 1.0), 41):
        after = tracker.step(frame(number, time_s + 0.3 * share)).box
    gone = after.cx - before.cx
    assert gone == pytest.approx(speed_px_s * 0.7 * (1 - math.exp(-0.3 / 0.7)), rel=0.1)


def test_a_frame_with_the_time_of_the_last_one_is_answered(
    tracker: FusionTracker, motion: ToldMotion
) -> None:
    follow(tracker, motion, going_right(3))
    for number, time_s in enumerate((3 / RATE_HZ, 2 / RATE_HZ), 4):
        assert tracker.step(frame(number, time_s)).state is TrackState.TRACKING


def test_frames_out_of_order_do_not_end_it(fusion: Trackers, motion: ToldMotion) -> None:
    tracker = fusion()
    tracker.start(frame(0), BOX)
    follow(tracker, motion, [*going_right(10), *unseen(3)])
    (back,) = follow(tracker, motion, unseen(1), 1)
    assert back.state is TrackState.COASTING
    assert follow(tracker, motion, going_right(1), 15)[0].state is TrackState.TRACKING


NONE = (math.nan, math.inf, -math.inf)


@pytest.mark.parametrize("score", NONE)
def test_a_detection_that_is_no_number_never_reaches_a_track(
    started: Trackers, motion: ToldMotion, score: float
) -> None:
    detector = ToldDetector()
    detector.sees = [seen(BOX, score), seen(BOX, 0.9)]
    tracker = started(detector)
    detector.sees = [seen(Box(140, 120, 20, 30), score), seen(BOX, 0.9)]
    for track in follow(tracker, motion, [[(BOX, 1.0)]] * 9):
        assert math.isfinite(track.confidence)
        assert track.box.distance(BOX) < 1


@pytest.mark.parametrize("score", NONE)
def test_an_answer_of_the_motion_tracker_that_is_no_number_is_no_sight(
    tracker: FusionTracker, motion: ToldMotion, score: float
) -> None:
    tracks = follow(tracker, motion, [[(BOX, score), (BOX.moved_to(150, 120), 0.3)]] * 3)
    assert all(math.isfinite(track.confidence) for track in tracks)
    assert tracks[-1].box.distance(BOX) < 1


def test_the_box_stays_on_the_image(tracker: FusionTracker, motion: ToldMotion) -> None:
    leaving = [[(BOX.moved_to(BOX.cx + 40 * k, BOX.cy), 1.0)] for k in range(1, 6)]
    for track in follow(tracker, motion, [*leaving, *unseen(30)])[5:]:
        assert 0 <= track.box.cx <= 320


def with_a_detector() -> FusionTracker:
    detector = ToldDetector()
    detector.sees = [seen(BOX), seen(Box(160, 120, 20, 30), 0.6)]
    return FusionTracker(CorrelationTracker(), detector)


def textured(number: int) -> Frame:
    """A patch of noise that goes right over other noise."""
    image = NOISE[0].copy()
    image[100:140, 80 + 2 * number : 120 + 2 * number] = NOISE[1][:40, :40]
    image[0, 0] = number
    return Frame(image, number / RATE_HZ, number)


def run(tracker: FusionTracker, frames: int = 12) -> list[Track]:
    first = tracker.start(textured(0), Box(100, 120, 40, 40))
    return [first, *(tracker.step(textured(number)) for number in range(1, frames))]


def test_the_same_frames_give_the_same_tracks_bit_for_bit() -> None:
    assert run(with_a_detector()) == run(with_a_detector())


def test_begun_anew_it_is_like_a_new_one() -> None:
    used = with_a_detector()
    run(used)
    assert run(used) == run(with_a_detector())


def test_the_listener_is_told_what_there_was_to_choose_from(
    fusion: Trackers, motion: ToldMotion
) -> None:
    choices: list[Choice] = []
    tracker = fusion()
    tracker.listener = choices.append
    tracker.start(frame(0), BOX)
    follow(tracker, motion, [[(BOX, 0.9), (BOX.moved_to(160, 120), 0.6)]])
    (choice,) = choices
    assert choice.sources[:2] == ("peak", "peak")
    assert choice.sources[-1] == "prediction"
    assert choice.corners[:2] == pytest.approx(corners_of([BOX, BOX.moved_to(160, 120)]))
    assert choice.chosen == 0
    assert len(choice.features) == len(choice.probabilities) == len(choice.sources)


@pytest.mark.parametrize(
    "wrong",
    [{"validate_every": 0}, {"doubt_every": 0}, {"crop_sizes": 0.0}, {"crop_least_px": math.inf}],
)
def test_settings_refuse_nonsense(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="fusion"):
        FusionSettings(**wrong)  # type: ignore[arg-type]
