"""Vision and control that fail as the schedule says, in lockstep and in real time."""

from __future__ import annotations

from typing import Any

import numpy as np

from follower.control_loop import ControlLoop
from follower.faults.fault import Kind
from follower.faults.schedule import FaultSchedule
from follower.flightlog import TrackRecord
from follower.realtime import VisionLoop
from follower_vision.clock import Clock, SimulatedClock
from follower_vision.frame import Frame

_LOOK_S = 0.02
_STARVED_SHARE = 0.2


class InjectedDeathError(RuntimeError):
    """The vision thread was made to die."""


class FaultyVision(VisionLoop):
    """See `VisionLoop`; the further arguments are its own."""

    def __init__(self, schedule: FaultSchedule, clock: Clock, *arguments: Any) -> None:
        stage, log, *others = arguments
        super().__init__(stage, clock, log, *others)
        self._schedule = schedule
        self._stands_still = isinstance(clock, SimulatedClock)
        self._busy_until_s = 0.0
        self.ended = False

    @property
    def is_free(self) -> bool:
        """Whether it takes a frame now, on a clock that stands still."""
        now_s = self._clock.now()
        dead = self._schedule.begun(Kind.VISION_DIES, now_s) is not None
        hung = self._schedule.active(Kind.VISION_HANGS, now_s) is not None
        return not dead and not hung and now_s >= self._busy_until_s

    def step(self, frame: Frame, delay_s: float = 0.0) -> TrackRecord:
        """Answer for one frame, late or never.

        Raises:
            InjectedDeathError: it is to die, in real time.
        """
        slow = self._schedule.active(Kind.VISION_SLOW, self._clock.now())
        if not self._stands_still:
            self._suffer(0.0 if slow is None else slow.amount)
        elif slow is not None:
            delay_s = slow.amount
        self._busy_until_s = self._clock.now() + delay_s
        return super().step(frame, delay_s)

    def _suffer(self, slow_s: float) -> None:
        if self._schedule.begun(Kind.VISION_DIES, self._clock.now()) is not None:
            raise InjectedDeathError("the vision thread was made to die")
        while not self.ended and self._schedule.active(Kind.VISION_HANGS, self._clock.now()):
            self._clock.sleep_until(self._clock.now() + _LOOK_S)
        self._clock.sleep_until(self._clock.now() + slow_s)


class FaultyControl(ControlLoop):
    """See `ControlLoop`; the further arguments are its own."""

    def __init__(
        self, schedule: FaultSchedule, clock: Clock, rng: np.random.Generator, *arguments: Any
    ) -> None:
        super().__init__(*arguments)
        self._schedule = schedule
        self._own_clock = clock
        self._rng = rng
        self._stands_still = isinstance(clock, SimulatedClock)
        self._paused_until_s = 0.0

    def step(self, now_s: float, late_s: float = 0.0) -> None:
        """Do one step of control, late or not at all."""
        self._pause(now_s)
        if self._stands_still and now_s < self._paused_until_s:
            return
        self._own_clock.sleep_until(self._paused_until_s)
        super().step(self._own_clock.now(), late_s)

    def _pause(self, now_s: float) -> None:
        if now_s < self._paused_until_s:
            return
        starved = self._schedule.active(Kind.CONTROL_STARVED, now_s)
        if starved is not None and self._rng.random() < _STARVED_SHARE:
            self._paused_until_s = now_s + float(self._rng.uniform(0.0, starved.amount))
        if self._schedule.active(Kind.CONTROL_STALLS, now_s) is not None:
            self._paused_until_s = self._schedule.end_of(Kind.CONTROL_STALLS, now_s)
