"""What Fusion believes of its target at present."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.fusion.forecasts import CALM_SIZES, Forecasts
from follower_vision.fusion.history import History, Moment
from follower_vision.fusion.kinematics import Kinematics
from follower_vision.fusion.rivals import Rivals
from follower_vision.fusion.strangers import Strangers
from follower_vision.fusion.warp import Warp
from follower_vision.fusion.witness import Witness
from follower_vision.prospect import Forecast, Prospect, has_middle
from follower_vision.track import Track, TrackState

SAME_IOU = 0.5
"""Two boxes that overlap so much are the same object's."""

_MARGIN_SIZES = 0.25
"""The middle of a box about what is seen of a target may be so far from the target's."""

_DISTRUST_S = 1.5
"""After so long others know the target's way again of which they were told wrong."""

_PATIENCE_S = 3.0
"""An unseen target is waited for so long where it should come out."""


@dataclass(frozen=True, slots=True)
class Confirmation:
    """A time at which the target was surely seen.

    Attributes:
        moment: the frame.
        box: the target's box there.
        velocity: pixels a second over the background, right and down.
    """

    moment: Moment
    box: Box
    velocity: tuple[float, float]

    def expected(self, history: History, moment: Moment) -> Box:
        """Return where the target would be in another frame if it went on like that."""
        warp = history.warp(self.moment, moment)
        interval_s = moment.captured_s - self.moment.captured_s
        return moved(warp.box(self.box), warp.turn(*self.velocity), interval_s)


class Belief:
    """The target's box and state, and where both come from.

    Attributes:
        box: where the target is, or is taken to be.
        previous: the same in the last frame's pixels.
        reference: a box of the last confirmed size.
        state: as in `Track`.
        confidence: as in `Track`.
        produced_by: as in `Track`.
        seen_s: when the target was last seen.
        history: the last frames.
        kinematics: where the target goes.
        taken: where the other targets are that are followed as well.
        rivals: look-alikes in the motion tracker's window.
        strangers: where they stood.
        prospect: where the target can be in the present frame, as others know.
        earlier: the same by what was believed of the target in the last seconds.
        witness: what the detector says of the motion tracker's places.
        familiar: whether the detector knows the target.
        confirmation: the detector's last sight of it.
    """

    def __init__(self, frame: Frame, box: Box, produced_by: str) -> None:
        self.box = self.previous = self.reference = box
        self.state = TrackState.TRACKING
        self.confidence = 1.0
        self.produced_by = produced_by
        self.seen_s = frame.captured_s
        self.familiar = False
        self.history = History()
        self.kinematics = Kinematics(box)
        self.taken: Sequence[Box] = ()
        self.rivals = Rivals()
        self.strangers = Strangers()
        self.prospect: Prospect | None = None
        self.earlier: tuple[Forecast, ...] = ()
        self._distrusted_until_s = self._misled_s = -math.inf
        self.witness = Witness()
        self._forecasts = Forecasts(box)
        moment = self.history.add(frame.captured_s, Warp(), box)
        self.confirmation = Confirmation(moment, box, (0.0, 0.0))
        self._anchor = self.confirmation
        self._anchor_size = box

    def is_free(self, box: Box) -> bool:
        """Whether a box is no other target's."""
        return all(box.iou(other) < SAME_IOU for other in self.taken)

    def is_possible(self, box: Box) -> bool:
        """Whether the target can be where a box is in the present frame."""
        return self.prospect is None or self._has_middle(self.prospect.possible, box)

    def is_likely(self, box: Box) -> bool:
        """Whether an unseen target is to be expected where a box is in the present frame.

        It is waited for there for some seconds; after that every place where it can be counts.
        """
        if self.prospect is None or not self.waits:
            return self.is_possible(box)
        return self._has_middle(self.prospect.likely, box)

    def _has_middle(self, region: Box, box: Box) -> bool:
        return has_middle(region, box, _MARGIN_SIZES * self.reference.scale)

    @property
    def waits(self) -> bool:
        """Whether an unseen target is waited for where it should come out."""
        return self.prospect is not None and self.unseen_s <= _PATIENCE_S

    def distrust_prospects(self, since_s: float) -> None:
        """Another than the target was followed since a time: what others know is that one's way."""
        self._misled_s = since_s
        self._distrusted_until_s = self.now.captured_s + _DISTRUST_S
        self.expect(None, self.now.captured_s)

    def expect(self, prospect: Prospect | None, captured_s: float) -> None:
        """Take where the target can be in the frame of a time, as others know."""
        trusted = captured_s > self._distrusted_until_s
        self.prospect = prospect if trusted else None
        known = () if prospect is None else prospect.earlier
        self.earlier = tuple(one for one in known if not self._is_misled(one.since_s))

    def _is_misled(self, since_s: float) -> bool:
        """Whether what was believed at a time was of another than the target, or still half so."""
        return self._misled_s < since_s <= self._distrusted_until_s

    def foresee(self, expected: Box) -> Box:
        """Expect a lost target where it should be by what others know."""
        if self.prospect is None or self.state is not TrackState.LOST:
            return expected
        self.box = self._foreseen(expected)
        self.kinematics.restart(self.box)
        return self.box

    def return_to(self, expected: Box) -> Box:
        """Go back to where the target should be, by what others know if they know it."""
        place = self._foreseen(expected)
        self.kinematics.restart(place, self.kinematics.velocity)
        return place

    def _foreseen(self, expected: Box) -> Box:
        prospect = self.prospect
        return expected if prospect is None else expected.moved_to(prospect.cx, prospect.cy)

    def refuse_stranger(self, box: Box, expected: Box) -> bool:
        """Refuse a box that is rather a look-alike's, which is remembered to be there."""
        return self.strangers.refuse(box, expected, self.unseen_s, self.history)

    @property
    def now(self) -> Moment:
        """The present frame."""
        return self.history.now

    @property
    def unseen_s(self) -> float:
        """How long the target has not been seen."""
        return self.now.captured_s - self.seen_s

    @property
    def unconfirmed_s(self) -> float:
        """How long ago the detector last saw the target."""
        return self.now.captured_s - self.confirmation.moment.captured_s

    def advance(self, captured_s: float, warp: Warp, predict: bool) -> Box:
        """Go on to the next frame, and return where the target should be in it.

        Args:
            captured_s: the frame's capture time.
            warp: the camera's motion.
            predict: whether the target's own velocity counts.
        """
        interval_s = captured_s - self.now.captured_s
        expected = self.kinematics.advance(warp, interval_s)
        self.rivals.advance(interval_s)
        self._forecasts.forecast(self.place_ahead(), expected if predict else None)
        self.previous = self.box
        self.box = warp.box(self.box)
        self.history.add(captured_s, warp, self.box)
        return expected if predict else self.box

    def place_ahead(self) -> Box:
        """Return where the target should be in the next image, by its places in the last two.

        A target that hardly moves across the image should be where it is; one that moves fast, as
        when the camera swings, should move on.
        """
        right, down = self.box.cx - self.previous.cx, self.box.cy - self.previous.cy
        if math.hypot(right, down) < CALM_SIZES * self.box.scale:
            return self.box
        return self.box.moved_to(self.box.cx + right, self.box.cy + down)

    @property
    def ahead(self) -> Box:
        """The place where the motion tracker looks ahead in the present frame."""
        return self._forecasts.ahead

    def about_ahead(self, place: Box) -> Box:
        """Return the place where the motion tracker looked ahead, if a place is about the same."""
        return self._forecasts.about_ahead(place)

    def carried_on(self) -> Box:
        """Return where the box of the last image is, by the forecast that is the better one."""
        return self._forecasts.ahead_if_better or self.box

    def see(self, box: Box, confidence: float, produced_by: str) -> None:
        """The target is here."""
        self._forecasts.learn(box)
        self.box = box
        self.state = TrackState.TRACKING
        self.confidence = confidence
        self.produced_by = produced_by
        self.seen_s = self.now.captured_s

    def confirm(self, moment: Moment, box: Box) -> None:
        """The detector saw the target in a frame of the history."""
        self.confirmation = Confirmation(moment, box, self.kinematics.velocity)

    def anchor(self) -> None:
        """The target is seen without any doubt: here a doubtful track begins again."""
        self._anchor = Confirmation(self.now, self.box, self.kinematics.velocity)
        self._anchor_size = self.reference

    def return_to_anchor(self) -> Box:
        """Forget what was believed since the last anchor; return where the target should be."""
        if self.history.at(self._anchor.moment.index) is None:
            return self.kinematics.box
        expected = self._anchor.expected(self.history, self.now)
        turned = self.history.warp(self._anchor.moment, self.now).turn(*self._anchor.velocity)
        self.reference = self._anchor_size
        self.kinematics.restart(expected, turned)
        return expected

    def present(self, moment: Moment, box: Box) -> Box:
        """Bring a box that the target had in an earlier frame to the present one."""
        warp = self.history.warp(moment, self.now)
        interval_s = self.now.captured_s - moment.captured_s
        return moved(warp.box(box), self.kinematics.velocity, interval_s)

    def track(self, frame: Frame) -> Track:
        """Return the belief as a track."""
        confidence = self.confidence if self.state is TrackState.TRACKING else 0.0
        return Track(
            self.box, self.state, confidence, self.produced_by, frame.captured_s, frame.sequence
        )


def moved(box: Box, velocity: tuple[float, float], interval_s: float) -> Box:
    """Return a box after a time at constant velocity."""
    return box.moved_to(box.cx + velocity[0] * interval_s, box.cy + velocity[1] * interval_s)


def towards(box: Box, other: Box, share: float) -> Box:
    """Return the box with a size between its own (share 0) and another's (1), as logarithms."""
    width = box.width * (other.width / box.width) ** share
    height = box.height * (other.height / box.height) ** share
    return Box(box.cx, box.cy, width, height)
