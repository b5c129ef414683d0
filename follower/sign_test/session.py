"""One sign test: link and camera in, words and a verdict out; nothing is made to move."""

from __future__ import annotations

import math
from dataclasses import dataclass

from follower.links.link import Link
from follower.settings import Settings
from follower.sign_test.dry_run import DryRun, Wish
from follower.sign_test.evidence import Evidence, Judgement, Sign
from follower.sign_test.reaction import Reaction
from follower.sign_test.words import diagnosis, intent, movers, picture, progress, where
from follower.vision_stage import Selector, VisionStage
from follower_vision.frame import Frame
from follower_vision.target_tracker import TargetTracker
from follower_vision.track import Track, TrackState

_WRONG_FOR_S = 3.0
_SILENT_S = 3.0


@dataclass(frozen=True, slots=True)
class SignTestResult:
    """How a sign test ended.

    Attributes:
        passed: everything agrees.
        text: what was found, and what to do.
    """

    passed: bool
    text: str


class SignTest:
    """Stepped by whoever has the frames; see docs/fly.md for what it finds and how.

    Args:
        settings: all of them.
        link: to the autopilot; polled, never asked to move anything.
        tracker: fresh.
        selector: finds the target.
        size: width and height of the frames.
    """

    def __init__(
        self,
        settings: Settings,
        link: Link,
        tracker: TargetTracker,
        selector: Selector,
        size: tuple[int, int],
    ) -> None:
        self._mount = settings.camera.mount
        self._link = link
        self._size = size
        self._vision = VisionStage(tracker)
        self._vision.select(selector)
        self._dry_run = DryRun(settings, settings.camera.model(*size))
        self._evidence = Evidence(self._mount)
        self._reaction = Reaction()
        self._turns = "yaw" in movers(self._mount)
        self._track: Track | None = None
        self._wish: Wish | None = None
        self._wrong_since_s = math.inf

    def step(self, now_s: float, frame: Frame | None) -> SignTestResult | None:
        """Do one step with a new frame, or with none; return the result once there is one."""
        self._link.poll(now_s)
        vehicle = self._link.state
        if vehicle.armed:
            return SignTestResult(
                False, "the vehicle is armed: disarm it, take the propellers off, and begin again"
            )
        if frame is not None:
            self._track = self._vision.step(frame)
            self._vision.learn()
        self._wish, look = self._dry_run.step(now_s, self._track, vehicle, self._link.attitudes)
        if look is not None:
            self._evidence.add(look.time_s, look.ray, look.attitude)
        if look is not None and self._wish is not None and vehicle.attitude is not None:
            asked = self._wish.setpoint.yaw_rate_rad_s
            self._reaction.add(now_s, vehicle.attitude.yaw_rad, asked)
        return self._result(now_s)

    def lines(self, now_s: float) -> list[str]:
        """Return what to show: the picture, the words, what is known and what to do."""
        box = None if self._track is None else self._track.box
        seen = self._track is not None and self._track.state is TrackState.TRACKING
        asked = None if self._wish is None else self._wish.setpoint
        lines = picture(box if seen else None, self._size, asked)
        if self._link.state.heartbeat_age_s(now_s) > _SILENT_S:
            return [*lines, "waiting for the autopilot"]
        if not seen or self._wish is None:
            return [*lines, "the target is not seen"]
        lines += [f"{where(self._wish)} -> {intent(self._wish.setpoint)}"]
        judgement = self._evidence.judge()
        lines += progress(judgement, self._mount)
        lines += [self._turning()] if self._turns else []
        wrong = diagnosis(judgement)
        return [*lines, f"WRONG: {wrong}"] if wrong else lines

    def summary(self) -> str:
        """Return what is known, for somebody who ends the test early."""
        return "; ".join([*progress(self._evidence.judge(), self._mount), self._turning()])

    def _turning(self) -> str:
        return {
            Sign.WAITING: "turning back: turn the vehicle left and right by hand",
            Sign.RIGHT: "turning back: would turn against your hand, towards the target",
            Sign.REVERSED: "turning back: WRONG, would turn with your hand, away from the target",
        }.get(self._reaction.judge(), "turning back: unclear, does the target stand still?")

    def _result(self, now_s: float) -> SignTestResult | None:
        judgement, turn = self._evidence.judge(), self._reaction.judge()
        if judgement.passed and (turn is Sign.RIGHT or not self._turns):
            return SignTestResult(True, "the camera sees as the settings say; " + self.summary())
        if not self._is_wrong(judgement, turn):
            self._wrong_since_s = math.inf
            return None
        self._wrong_since_s = min(self._wrong_since_s, now_s)
        complete = Sign.WAITING not in (judgement.across, judgement.down)
        if complete and now_s - self._wrong_since_s >= _WRONG_FOR_S:
            return SignTestResult(False, diagnosis(judgement) or self._turning())
        return None

    @staticmethod
    def _is_wrong(judgement: Judgement, turn: Sign) -> bool:
        return judgement.is_wrong or turn is Sign.REVERSED
