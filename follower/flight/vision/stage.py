"""Frames in, tracks out: what the vision thread runs."""

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

from follower.flight.operator_requests import OperatorRequests
from follower.flight.target.request import (
    ClearSelection,
    ObjectSelection,
    RequestOutcome,
    TargetFinder,
    TargetRequest,
)
from follower.flight.target.selectors import Selector
from follower_vision.detection.detection_service import DetectionAnswer
from follower_vision.fusion import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.target_tracker import (
    AcceptsPrediction,
    TargetPrediction,
    TargetTracker,
)
from follower_vision.trackers.track import Track, TrackState

Prospects: TypeAlias = Callable[[float, int], TargetPrediction | None]
"""Returns where in a frame with a time stamp the target can be, after so many choices of one."""

_SEEK_S = 0.7
"""For how many seconds an object that was just seen is searched for."""
_REPLACED = RequestOutcome(False, "another target was asked for before it was seen again")
_LONGEST_GAP_S = 1.0
"""Without a frame for longer, nobody can know what they choose."""
_TOO_OLD = RequestOutcome(False, "no frames came for a moment: choose again")
_SAME_IOU = 0.5
"""What overlaps the target's last box so much is no other target."""
OUT_OF_ORDER = "out of order"
"""What a track is said to be produced by that answers for a frame from the past."""


class VisionStage:
    """Selects the target when asked to, then follows it frame by frame.

    `select` may be called from any thread; the newest one counts.

    Args:
        tracker: fresh.
        requests: selections of a target are taken from there, one a frame.
        finder: finds what they mean.

    Attributes:
        prospects: asked before a frame is looked at, if anybody knows.
        prospect: what was known of the newest frame.
        chosen: the box by which the newest step chose the target, None if it did not.
        detected: what the newest step took of a detector that answers in its own time.
        dropped: whether the newest step gave the target up, because somebody wanted none.
        requests_done: how many selections of an operator were carried out so far.
        replaced: how often another target took the place of the one followed, chosen by `select`.
    """

    def __init__(
        self,
        tracker: TargetTracker,
        requests: OperatorRequests | None = None,
        finder: TargetFinder | None = None,
    ) -> None:
        self._tracker = tracker
        self._predicted = tracker if isinstance(tracker, AcceptsPrediction) else None
        self._requests = requests
        self._finder = finder or TargetFinder()
        self._selecting = threading.Lock()
        self._selector: Selector | None = None
        self._started = self._drops = False
        self._sought: TargetRequest | None = None
        self._newest_s = self._seek_until_s = -math.inf
        self._track: Track | None = None
        self.prospects: Prospects | None = None
        self.prospect: TargetPrediction | None = None
        self.chosen: Box | None = None
        self.detected: Sequence[DetectionAnswer] = ()
        self.dropped = False
        self.requests_done = self.replaced = 0

    @property
    def needs_picture(self) -> bool:
        """Whether the next step uses its frame's picture: once somebody wants a target."""
        wanted = self._requests is not None and self._requests.target_waits
        return self._started or wanted or self._selector is not None or self._sought is not None

    def select(self, selector: Selector) -> None:
        """Choose a new target in the coming frames, as soon as `selector` finds one."""
        with self._selecting:
            self._selector = selector

    def drop(self) -> None:
        """Have no target from the next frame on; for a thread that steps."""
        self._drops = True

    def step(self, frame: Frame) -> Track | None:
        """Return the target's track in this frame, None while there is no target.

        A frame that is not newer than the last one is not looked at, and answered with where the
        target was then, unseen: trackers measure by the time between frames.
        """
        self.chosen, self.dropped, self.prospect = None, False, None
        self.detected = ()
        if not frame.captured_s > self._newest_s:
            return self._out_of_order(frame)
        gap_s, self._newest_s = frame.captured_s - self._newest_s, frame.captured_s
        if _LONGEST_GAP_S < gap_s < math.inf:
            self._refuse_old_request()
        before = self._track
        asked = self._take_request(frame)
        try:
            self._track = self._followed(frame)
        except ValueError as error:  # the tracker cannot follow what the operator drew
            if asked is None or self.chosen is None:
                raise
            asked = asked[0], RequestOutcome(False, str(error))
            self._track, self.chosen, self._started, self.dropped = None, None, False, True
        if asked is not None:
            self._answer(*asked)
        elif self.chosen is not None and before is not None:
            self.replaced += before.box.iou(self.chosen) < _SAME_IOU
        if self._started and isinstance(self._tracker, FusionTracker):
            self.detected = self._tracker.late_answers
        return self._track

    def _refuse_old_request(self) -> None:
        """Refuse a selection of what was seen before no frames came: it may be something else."""
        newest = None if self._requests is None else self._requests.take_target()
        drops = newest is not None and isinstance(newest.selection, ClearSelection)
        for request in (self._sought, None if drops else newest):
            if request is not None:
                request.settle(_TOO_OLD)
        self._sought = newest if drops else None

    def _take_request(self, frame: Frame) -> tuple[TargetRequest, RequestOutcome] | None:
        """Return what an operator wants that is carried out in this frame, and what comes of it."""
        request = self._request_now(frame)
        if request is None:
            return None
        outcome = self._finder.find(request.selection, frame)
        box = outcome.box
        looks_on = (
            isinstance(request.selection, ObjectSelection) and frame.captured_s < self._seek_until_s
        )
        if box is None and looks_on:  # a detector does not see a thing in each frame
            return None
        self._sought = None
        if outcome.accepted:
            self.requests_done += 1
            if box is None:
                self.drop()
            else:
                self.select(lambda _: box)
        return request, outcome

    def _answer(self, request: TargetRequest, outcome: RequestOutcome) -> None:
        if self._requests is not None:
            self._requests.note((f"{request.selection}, by {request.by}: {outcome.text}",))
        request.settle(outcome)

    def _request_now(self, frame: Frame) -> TargetRequest | None:
        """Return what somebody wants: the newest selection, else the one still looked for."""
        fresh = None if self._requests is None else self._requests.take_target()
        if fresh is not None:
            if self._sought is not None:
                self._sought.settle(_REPLACED)
            self._sought, self._seek_until_s = fresh, frame.captured_s + _SEEK_S
        if self._sought is not None and self._sought.outcome is not None:
            self._sought = None  # control has refused it
        return self._sought

    def _followed(self, frame: Frame) -> Track | None:
        if self._drops:
            self.dropped, self._drops = self._started, False
            self._started, self._selector = False, None
        selector = self._selector
        if selector is not None:
            self.chosen = selector(frame)
        if self.chosen is not None:
            with self._selecting:  # somebody may have chosen anew while the frame was searched
                self._selector = None if self._selector is selector else self._selector
            self._started = True
            return self._tracker.start(frame, self.chosen)
        return self._stepped(frame) if self._started else None

    def _stepped(self, frame: Frame) -> Track:
        if self.prospects is not None and self._predicted is not None:
            self.prospect = self.prospects(frame.captured_s, self.requests_done + self.replaced)
            self._predicted.expect(self.prospect)
        return self._tracker.step(frame)

    def _out_of_order(self, frame: Frame) -> Track | None:
        if self._track is None:
            return None
        return replace(
            self._track,
            state=TrackState.COASTING,
            confidence=0.0,
            produced_by=OUT_OF_ORDER,
            captured_s=frame.captured_s,
            sequence=frame.sequence,
        )
