"""A vision that hangs for ever neither holds up control nor keeps the program alive."""

import signal
import threading
import time

import pytest

from follower.flight.threads import RealtimeRun
from follower_vision.clock import MonotonicClock
from follower_vision.mailbox import Mailbox


class Hung:
    """A source that gives one frame after the other, and a vision that never answers."""

    def __init__(self) -> None:
        self.forever, self.hangs = threading.Event(), threading.Event()
        self.steps = self.holds = 0
        self.tracks = Mailbox[object]()

    def read(self) -> object:
        time.sleep(0.02)
        return object()

    def close(self) -> None:
        pass

    def step(self, *_: object) -> None:
        if threading.current_thread().name == "_vision_loop":
            self.hangs.set()
            self.forever.wait()
        self.steps += 1

    def hold(self) -> None:
        self.holds += 1


@pytest.mark.slow
def test_a_hung_vision_is_left_behind() -> None:
    hung = Hung()
    clock = MonotonicClock()
    run = RealtimeRun(clock, hung, hung, hung, 50.0)  # type: ignore[arg-type]
    begin_s = clock.now()

    def goes_on() -> bool:
        """Half a second, and on a busy computer until vision has come so far as to hang."""
        passed_s = clock.now() - begin_s
        return passed_s < 0.5 or (not hung.hangs.is_set() and passed_s < 20.0)

    run.run(goes_on)
    assert hung.steps > 0
    assert hung.holds == 1
    left = [thread for thread in threading.enumerate() if thread.name == "_vision_loop"]
    assert [thread.daemon for thread in left] == [True]
    hung.forever.set()


class Braking(Hung):
    """A control that comes to rest ten steps after it was told to release, on a lossy line."""

    def __init__(self) -> None:
        super().__init__()
        self.forever.set()
        self.asked_at: int | None = None
        self.rested_before_the_holds = self.impatient = False

    def release(self) -> None:
        self.asked_at = self.steps

    @property
    def rests(self) -> bool:
        return self.asked_at is not None and self.steps >= self.asked_at + 10

    def hold(self) -> bool:  # type: ignore[override]
        self.rested_before_the_holds = self.rests
        self.holds += 1
        if self.impatient:
            signal.raise_signal(signal.SIGINT)
        return True


@pytest.mark.slow
def test_a_watcher_that_fails_leaves_control_the_time_to_brake() -> None:
    """As a display does whose terminal is gone."""
    control = Braking()
    run = RealtimeRun(MonotonicClock(), control, control, control, 50.0)  # type: ignore[arg-type]

    def watch() -> bool:
        if control.steps > 5:
            raise OSError(5, "Input/output error")
        return True

    with pytest.raises(OSError, match="Input/output"):
        run.run(watch)
    assert control.asked_at is not None
    assert control.rested_before_the_holds


@pytest.mark.slow
def test_the_last_hold_is_said_more_than_once() -> None:
    control = Braking()
    run = RealtimeRun(MonotonicClock(), control, control, control, 50.0)  # type: ignore[arg-type]
    run.run(lambda: control.steps < 3)
    assert control.holds >= 3


@pytest.mark.slow
def test_ctrl_c_held_down_takes_no_last_word_away() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    control = Braking()
    control.impatient = True
    run = RealtimeRun(MonotonicClock(), control, control, control, 50.0)  # type: ignore[arg-type]
    try:
        with pytest.raises(KeyboardInterrupt):
            run.run(lambda: control.steps < 3)
    finally:
        signal.signal(signal.SIGINT, before)
    assert control.holds >= 3
