"""A look-alike that came before the target is left again for it, by what was foretold before."""

import math
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given

from follower_vision.box import Box
from follower_vision.correlation import CorrelationTracker
from follower_vision.frame import Frame
from follower_vision.fusion.approaches import Approaches
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.finding import Finding
from follower_vision.fusion.following import Following
from follower_vision.fusion.history import Moment
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.neighbours import Neighbours
from follower_vision.fusion.parting import Parting
from follower_vision.fusion.regions import Regions
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.validation import Sight, Validation
from follower_vision.fusion.warp import Warp
from follower_vision.prospect import Forecast, Prospect

SIZE = 40.0
TARGET, OTHER = Box(300, 200, SIZE, SIZE), Box(352, 215, SIZE, SIZE)
FAR = Box(420, 200, SIZE, SIZE)
MET_S, PARTED_S, LOOK_S = 0.5, 1.2, 0.1
REACH = Box(0, 0, 60, 60)
REACH_HERE = REACH.moved_to(TARGET.cx, TARGET.cy)


def forecast(since_s: float, box: Box, nearer: float = 1.0) -> Forecast:
    return Forecast(since_s, box.cx, box.cy, REACH.moved_to(box.cx, box.cy), nearer)


class Crossing:
    """Two that were one from 0.5 s on, and a belief that went with the one at `followed`.

    What was believed before 0.5 s foretells `foretold`, what was believed later the one followed.
    """

    def __init__(self, foretold: Box = TARGET, followed: Box = OTHER, nearer: float = 1.0) -> None:
        self.belief = Belief(Frame(np.zeros((480, 640, 3), np.uint8), 0.0, 0), foretold, "test")
        self.neighbours, self.parting = Neighbours(), Parting()
        self._followed = followed
        known = [forecast(one / 10, foretold, nearer) for one in range(5, -1, -1)]
        late = [forecast(one / 10, followed) for one in range(11, 5, -1)]
        self.tell(Prospect(followed.cx, followed.cy, REACH, REACH, (*late, *known)))
        for number in range(1, 12):
            self.step(number * LOOK_S)

    def tell(self, prospect: Prospect | None) -> None:
        self.belief.expect(prospect, self.belief.now.captured_s)

    def step(self, now_s: float, warp: Warp | None = None) -> Moment:
        return self.belief.history.add(now_s, warp or Warp(), self._followed)

    def look(self, boxes: list[Box], now_s: float, followed: Box | None = None) -> Box | None:
        moment = self.step(now_s)
        followed = followed or self._followed
        self.neighbours.meet(followed, self.belief.history, moment)
        found = self.parting.parted(self.belief, moment, boxes, followed, self.neighbours)
        rest = [box for box in boxes if box is not followed]
        self.neighbours.see(rest, rest, self.belief.history, moment)
        return None if found is None else found[0]


def test_when_the_two_part_the_one_that_goes_on_as_before_is_the_target() -> None:
    crossing = Crossing()
    assert crossing.look([OTHER, TARGET], PARTED_S) is None  # a single sight may be wrong
    assert crossing.look([OTHER, TARGET], PARTED_S + LOOK_S) is TARGET


@pytest.mark.parametrize(("agreeing", "found"), [(2, False), (3, True)])
def test_a_forecast_or_two_may_be_that_of_a_target_in_a_turn(agreeing: int, *, found: bool) -> None:
    crossing = Crossing()
    prospect = crossing.belief.prospect
    assert prospect is not None
    crossing.tell(replace(prospect, earlier=prospect.earlier[-agreeing:]))
    crossing.look([OTHER, TARGET], PARTED_S)
    assert (crossing.look([OTHER, TARGET], PARTED_S + LOOK_S) is TARGET) is found


def test_what_may_be_the_target_is_looked_at_for_half_a_second_wherever_the_camera_turns() -> None:
    crossing = Crossing()
    assert crossing.parting.suspect(crossing.belief) is None
    crossing.look([OTHER, TARGET], PARTED_S)
    crossing.step(PARTED_S + 0.4, Warp(right=25.0))
    assert crossing.parting.suspect(crossing.belief) == TARGET.moved_to(TARGET.cx + 25, TARGET.cy)
    crossing.step(PARTED_S + 0.5)
    assert crossing.parting.suspect(crossing.belief) is None


def test_two_sights_count_only_if_one_comes_soon_after_the_other_at_the_same_place() -> None:
    late = Crossing()
    assert late.look([OTHER, TARGET], PARTED_S) is None
    assert late.look([OTHER, TARGET], PARTED_S + 0.6) is None
    elsewhere = Crossing()
    assert elsewhere.look([OTHER, TARGET.moved_to(290, 165)], PARTED_S) is None
    assert elsewhere.look([OTHER, TARGET.moved_to(310, 225)], PARTED_S + LOOK_S) is None


def test_who_was_apart_from_the_target_before_is_not_it_wherever_it_goes() -> None:
    crossing = Crossing(followed=FAR)
    history = crossing.belief.history
    for number in (3, 5, 7):
        moment = history.at(number)
        assert moment is not None
        crossing.neighbours.see([TARGET], [TARGET], history, moment)
    for number in range(4):
        assert crossing.look([FAR, TARGET], PARTED_S + number * LOOK_S) is None


def test_whoever_turns_up_farther_away_never_was_where_the_target_was() -> None:
    crossing = Crossing(followed=FAR)
    for number in range(4):
        assert crossing.look([FAR, TARGET], PARTED_S + number * LOOK_S) is None


def test_a_track_that_leaps_back_to_the_look_alike_is_sent_away_again() -> None:
    """The two are apart by then, but were taken for one another a moment before."""
    crossing, prospect = Crossing(), None
    for number in range(2):
        prospect = crossing.belief.prospect or prospect
        found = crossing.look([OTHER, TARGET], PARTED_S + number * LOOK_S)
    assert found is TARGET
    crossing.belief.distrust_prospects(MET_S)
    crossing.neighbours = Neighbours()
    for number in range(2, 4):
        crossing.belief.expect(prospect, PARTED_S + number * LOOK_S)
        assert crossing.look([FAR, TARGET], PARTED_S + number * LOOK_S, FAR) is TARGET


def test_who_has_long_been_apart_again_stays_what_it_is() -> None:
    crossing = Crossing()
    prospect = crossing.belief.prospect
    crossing.tell(None)
    assert crossing.look([OTHER, TARGET], PARTED_S) is None
    for number in range(1, 12):
        assert crossing.look([FAR, TARGET], PARTED_S + number * LOOK_S, FAR) is None
    crossing.tell(prospect)
    for number in range(12, 16):
        assert crossing.look([FAR, TARGET], PARTED_S + number * LOOK_S, FAR) is None


@pytest.mark.parametrize(("met", "found"), [(8, True), (5, True), (4, True), (None, False)])
def test_whoever_was_beside_what_is_followed_may_be_the_target_though_it_was_known_before(
    met: int | None, *, found: bool
) -> None:
    crossing = Crossing(followed=FAR)
    history = crossing.belief.history
    for number in (3, 5, 7):
        moment = history.at(number)
        assert moment is not None
        crossing.neighbours.see([TARGET], [TARGET], history, moment)
    beside = None if met is None else history.at(met)
    if beside is not None:
        crossing.neighbours.meet(OTHER, history, beside)
    assert crossing.look([FAR, TARGET], PARTED_S) is None
    assert (crossing.look([FAR, TARGET], PARTED_S + LOOK_S) is TARGET) is found


@given(
    turn=st.floats(-math.pi, math.pi),
    away=st.floats(0, 22),
    beside=st.floats(60, 130),
    side=st.floats(-math.pi, math.pi),
)
def test_a_target_that_goes_about_where_foretold_is_not_left_for_one_beside_it(
    turn: float, away: float, beside: float, side: float
) -> None:
    """However it manoeuvres within what is likely, and wherever somebody new turns up."""
    followed = TARGET.moved_to(300 + away * math.cos(turn), 200 + away * math.sin(turn))
    other = TARGET.moved_to(300 + beside * math.cos(side), 200 + beside * math.sin(side))
    assume(other.distance(followed) > SIZE)
    crossing = Crossing(followed=followed)
    for number in range(3):
        assert crossing.look([followed, other], PARTED_S + number * LOOK_S) is None


def test_nobody_is_chosen_by_a_forecast_from_after_they_met() -> None:
    """Whoever was followed by then was followed for another reason."""
    crossing = Crossing(followed=FAR)
    prospect, history = crossing.belief.prospect, crossing.belief.history
    assert prospect is not None
    late = [one for one in prospect.earlier if one.since_s > MET_S]
    turned = tuple(replace(one, cx=TARGET.cx, cy=TARGET.cy, likely=REACH_HERE) for one in late)
    crossing.tell(replace(prospect, earlier=turned))
    moment = history.at(5)
    assert moment is not None
    crossing.neighbours.see([TARGET], [TARGET], history, moment)
    crossing.neighbours.meet(OTHER, history, moment)
    for number in range(3):
        assert crossing.look([FAR, TARGET], PARTED_S + number * LOOK_S) is None


@pytest.mark.parametrize(("nearer", "found"), [(4.0, True), (1.0, False)])
def test_a_size_that_the_way_explains_is_no_other_one(nearer: float, *, found: bool) -> None:
    grown = Box(300, 200, 4 * SIZE, 4 * SIZE)
    crossing = Crossing(nearer=nearer)
    crossing.look([OTHER, grown], PARTED_S)
    assert (crossing.look([OTHER, grown], PARTED_S + LOOK_S) is grown) is found


@pytest.mark.parametrize(
    ("size", "nearer", "found"), [(0.65, 0.65, True), (1.0, 1.0, False), (1.6, 1.0, False)]
)
def test_what_comes_out_from_behind_needs_less_to_be_the_target(
    size: float, nearer: float, *, found: bool
) -> None:
    """The nearer of two that were one was seen, and the nearer is the larger of a kind."""
    other = Box(316, 204, size * SIZE, size * SIZE)
    between = OTHER.moved_to((other.cx + OTHER.cx) / 2, (other.cy + OTHER.cy) / 2)
    crossing = Crossing(foretold=between, nearer=nearer)
    crossing.look([OTHER, other], PARTED_S)
    assert (crossing.look([OTHER, other], PARTED_S + LOOK_S) is other) is found
    alone = Crossing(foretold=between, nearer=nearer)
    alone.look([other], PARTED_S)
    assert alone.look([other], PARTED_S + LOOK_S) is None  # it may be a part of what is followed
    lately = Crossing(foretold=between, nearer=nearer)
    moment = lately.step(PARTED_S - LOOK_S)
    lately.neighbours.see([OTHER], [OTHER], lately.belief.history, moment)
    lately.look([other], PARTED_S)
    assert (lately.look([other], PARTED_S + LOOK_S) is other) is found


def test_without_forecasts_nothing_is_left() -> None:
    crossing = Crossing()
    crossing.tell(None)
    for number in range(3):
        assert crossing.look([OTHER, TARGET], PARTED_S + number * LOOK_S) is None


def test_a_late_sight_is_held_against_the_forecast_of_the_present_frame() -> None:
    """The camera has turned since; the forecast is of now, the boxes of then."""
    crossing = Crossing()
    for number in range(2):
        then = crossing.step(PARTED_S + number * LOOK_S)
        boxes = [OTHER.moved_to(302, 215), TARGET.moved_to(250, 200)]
        crossing.neighbours.meet(boxes[0], crossing.belief.history, then)
        crossing.step(PARTED_S + 0.03 + number * LOOK_S, Warp(right=50.0))
        found = crossing.parting.parted(crossing.belief, then, boxes, boxes[0], crossing.neighbours)
        crossing.step(PARTED_S + 0.06 + number * LOOK_S, Warp(right=-50.0))
    assert found is not None
    assert found[0] is boxes[1]


def _validation() -> Validation:
    settings = FusionSettings()
    looks = Looks(settings.reidentify, None)
    return Validation(settings, Following(CorrelationTracker(), settings, looks), looks)


def test_the_track_goes_all_the_way_to_the_target_that_overlaps_what_was_followed() -> None:
    """A sight of what is followed corrects the track in part; this one is of another."""
    followed = TARGET.moved_to(TARGET.cx + 0.53 * SIZE, TARGET.cy)
    small = Box(TARGET.cx, TARGET.cy, 0.9 * SIZE, 0.9 * SIZE)
    crossing = Crossing(followed=followed)
    settings = FusionSettings().without("appearance_check")
    looks = Looks(settings.reidentify, None)
    following = Following(CorrelationTracker(), settings, looks)
    image = np.random.default_rng(1).integers(0, 255, (480, 640, 3), np.uint8)
    following.start(Frame(image, 0.0, 0), followed)
    validation = Validation(settings, following, looks)
    belief = crossing.belief
    for number in range(2):
        belief.see(followed, 1.0, "test")
        moment = crossing.step(PARTED_S + number * LOOK_S)
        frame = Frame(image, moment.captured_s, number)
        sight = Sight(moment, [followed, small], [])
        validation.validate(frame, belief, sight, image)
    assert belief.box.distance(small) < 0.02 * SIZE
    assert belief.box.scale == belief.reference.scale == pytest.approx(small.scale)


def _regions() -> tuple[Regions, Frame, Belief]:
    settings = FusionSettings()
    looks = Looks(settings.reidentify, None)
    following = Following(CorrelationTracker(), settings, looks)
    finding = Finding(settings, following, _validation(), looks)
    frame = Frame(np.zeros((480, 640, 3), np.uint8), 0.0, 0)
    return Regions(settings, finding, looks), frame, Belief(frame, TARGET, "test")


def test_a_look_goes_elsewhere_if_that_is_in_the_image() -> None:
    regions, frame, belief = _regions()
    assert regions.next(frame, belief) == Box(TARGET.cx, TARGET.cy, 200, 200)
    assert regions.next(frame, belief, (belief.box, 0.6)).width == pytest.approx(120)
    assert regions.next(frame, belief, (FAR, 1.0)) == Box(FAR.cx, FAR.cy, 200, 200)
    left = FAR.moved_to(-5.0, 100.0)
    assert regions.next(frame, belief, (left, 1.0)) == Box(TARGET.cx, TARGET.cy, 200, 200)


def test_with_prospects_every_second_look_among_look_alikes_is_a_closer_one() -> None:
    crossing, validation = Crossing(foretold=OTHER), _validation()
    belief = crossing.belief
    belief.see(OTHER, 1.0, "test")
    assert [validation.elsewhere(belief, looks) for looks in range(4)] == [None] * 4
    moment = belief.now
    validation.neighbours.see([FAR], [FAR], belief.history, moment)
    closer = (OTHER, pytest.approx(0.6))
    assert [validation.elsewhere(belief, looks) for looks in range(4)] == [None, closer] * 2
    crossing.tell(None)
    assert [validation.elsewhere(belief, looks) for looks in range(4)] == [None] * 4


def test_every_second_look_is_at_the_place_foretold_if_the_track_fits_that_badly() -> None:
    crossing, validation = Crossing(followed=FAR, nearer=1.5), _validation()
    crossing.belief.see(FAR, 1.0, "test")
    assert validation.elsewhere(crossing.belief, 2) is None
    foretold = validation.elsewhere(crossing.belief, 1)
    assert foretold == (Box(TARGET.cx, TARGET.cy, 1.5 * SIZE, 1.5 * SIZE), 1.0)
    crossing.step(2.1)  # all that was believed before they met is older than 1.5 s by then
    assert validation.elsewhere(crossing.belief, 1) is None


def test_what_was_believed_during_a_mistake_never_counts() -> None:
    crossing = Crossing()
    belief, prospect = crossing.belief, crossing.belief.prospect
    assert prospect is not None
    belief.distrust_prospects(MET_S)
    belief.expect(prospect, belief.now.captured_s + 1.0)
    assert belief.earlier == tuple(one for one in prospect.earlier if one.since_s <= MET_S)
    now_s = belief.now.captured_s + 2.0
    later = forecast(now_s, TARGET)
    belief.expect(replace(prospect, earlier=(later, *prospect.earlier)), now_s)
    assert belief.earlier == (later, *(one for one in prospect.earlier if one.since_s <= MET_S))


def test_a_track_that_goes_back_to_the_look_alike_at_once_is_sent_away_again() -> None:
    crossing, times_s = Crossing(), [PARTED_S + number * LOOK_S for number in range(5)]
    prospect = crossing.belief.prospect
    found = []
    for now_s in times_s:
        crossing.belief.expect(prospect, now_s)
        found.append(crossing.look([OTHER, TARGET], now_s))
        if found[-1] is not None:
            crossing.belief.distrust_prospects(MET_S)
    assert found[0] is None
    assert all(one is TARGET for one in found[1:])


def test_after_a_mistake_the_others_prospects_are_not_asked_for_a_while() -> None:
    crossing = Crossing()
    belief, prospect = crossing.belief, crossing.belief.prospect
    belief.distrust_prospects(MET_S)
    assert belief.prospect is None
    belief.expect(prospect, belief.now.captured_s + 1.0)
    assert belief.prospect is None
    belief.expect(prospect, belief.now.captured_s + 2.0)
    assert belief.prospect is prospect


def _passing(speed: float, hidden_s: float, merged_s: float = 1.0) -> tuple[Approaches, Box, float]:
    """Somebody comes from the left at so many sizes a second, and hides the target for a while."""
    approaches, now_s = Approaches(), 0.0
    while now_s < 1.0:
        away = speed * (now_s - 1.0 - hidden_s / 2) - 1.1
        other = Box(TARGET.cx + away * SIZE, TARGET.cy + 0.2 * SIZE, SIZE, SIZE)
        approaches.see(now_s, TARGET, [other])
        now_s += LOOK_S
    while now_s < 1.0 + merged_s:
        approaches.see(now_s, TARGET, [])
        now_s += LOOK_S
    return approaches, other, now_s


@given(speed=st.floats(1.5, 4.0), turned=st.floats(-300, 300))
def test_who_comes_from_the_left_and_passes_goes_on_to_the_right(
    speed: float, turned: float
) -> None:
    """Wherever the camera turned meanwhile: it counts how the two stand to one another."""
    approaches, last, now_s = _passing(speed, hidden_s=0.0)
    right = (last.cx - TARGET.cx) / SIZE + speed * (now_s - 0.9)
    assume(right > 1.0)
    here = TARGET.moved_to(TARGET.cx + turned, TARGET.cy)
    there = here.moved_to(here.cx + right * SIZE, here.cy + 0.2 * SIZE)
    kept, since_s = approaches.exchanged(now_s, here, there)
    gone, _ = approaches.exchanged(now_s, there, here)
    assert kept < -0.3
    assert gone > 0.3
    assert gone == pytest.approx(-kept, abs=0.05)
    assert since_s == pytest.approx(0.9, abs=0.11)


@pytest.mark.parametrize(
    ("foretold", "passes", "found"),
    [(0.0, False, True), (0.5, False, False), (0.5, True, True), (1.0, True, False)],
)
def test_who_came_past_goes_on_unless_forecasts_deny_it(
    foretold: float, *, passes: bool, found: bool
) -> None:
    """At two sizes a second to the right, with the track: 1.2 of them from the target by then.

    The forecasts say that the target is so far, from 0 to 1, on the way to who came past.
    """

    def passer(now_s: float) -> Box:
        return TARGET.moved_to(TARGET.cx + 2.0 * SIZE * (now_s - 1.4), TARGET.cy)

    parted_s = 2.0
    gone = passer(parted_s)
    where = TARGET.moved_to(TARGET.cx + foretold * (gone.cx - TARGET.cx), TARGET.cy)
    crossing = Crossing(foretold=where, followed=TARGET)
    crossing.belief = Belief(Frame(np.zeros((480, 640, 3), np.uint8), 0.0, 0), TARGET, "test")
    for number in range(1, 10):
        boxes = [TARGET, passer(number * LOOK_S)] if passes else [TARGET]
        assert crossing.look(boxes, number * LOOK_S) is None
    for number in range(10, 20):
        alone = TARGET if number < 14 else passer(number * LOOK_S)
        assert crossing.look([alone], number * LOOK_S, alone) is None
    known = tuple(forecast(one / 10, where) for one in range(8, -1, -1))
    chosen = None
    for now_s in (parted_s, parted_s + LOOK_S):
        crossing.tell(Prospect(gone.cx, gone.cy, REACH, REACH, known))
        chosen = crossing.look([passer(now_s), TARGET], now_s, passer(now_s))
    assert (chosen is TARGET) is found


def test_nobody_passed_who_stays_away_or_was_seen_for_a_moment_or_long_ago() -> None:
    beside = Approaches()
    for number in range(10):
        other = Box(TARGET.cx - 3 * SIZE, TARGET.cy + (number - 5) * SIZE / 5, SIZE, SIZE)
        beside.see(number * LOOK_S, TARGET, [other])
    assert beside.exchanged(1.5, FAR, TARGET) == (0.0, math.inf)
    glimpsed = Approaches()
    glimpsed.see(0.0, TARGET, [OTHER])
    assert glimpsed.exchanged(0.5, FAR, TARGET) == (0.0, math.inf)
    old, _, now_s = _passing(2.0, 0.0, merged_s=3.5)
    assert old.exchanged(now_s, FAR, TARGET) == (0.0, math.inf)
