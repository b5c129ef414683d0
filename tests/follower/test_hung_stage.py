"""A vision that hangs for ever neither holds up control nor keeps the program alive."""

import threading
import time

from follower.realtime import RealtimeRun
from follower_vision.clock import MonotonicClock


class Hung:
    """A source that gives one frame after the other, and a vision that never answers."""

    def __init__(self) -> None:
        self.forever = threading.Event()
        self.steps = self.holds = 0

    def read(self) -> object:
        time.sleep(0.02)
        return object()

    def close(self) -> None:
        pass

    def step(self, *_: object) -> None:
        if threading.current_thread().name == "_vision_loop":
            self.forever.wait()
        self.steps += 1

    def hold(self) -> None:
        self.holds += 1


def test_a_hung_vision_is_left_behind() -> None:
    hung = Hung()
    clock = MonotonicClock()
    run = RealtimeRun(clock, hung, hung, hung, 50.0)  # type: ignore[arg-type]
    end_s = clock.now() + 0.5
    run.run(lambda: clock.now() < end_s)
    assert hung.steps > 10
    assert hung.holds == 1
    assert any(thread.name == "_vision_loop" for thread in threading.enumerate())
    assert all(t.daemon for t in threading.enumerate() if t is not threading.main_thread())
    hung.forever.set()
