"""Work on a thread that somebody watches: its end, its errors, and Ctrl-C."""

import os
import signal
import threading
from contextlib import suppress

import pytest

from follower.ui.terminal.interrupt import run_watched, stop_signals


def test_the_result_comes_back_and_somebody_looked_meanwhile() -> None:
    looked = threading.Event()
    result, interrupted = run_watched(lambda: looked.wait(60), looked.set, lambda: None)
    assert result
    assert not interrupted


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_stops_the_work_and_breaks_off_nothing_that_the_watcher_does(
    how: signal.Signals,
) -> None:
    stop, lock, looks = threading.Event(), threading.Lock(), []

    def look() -> None:
        with lock:
            os.kill(os.getpid(), how)
            threading.Event().wait(0.05)
            looks.append(1)

    def work() -> str:
        assert stop.wait(60)
        with lock:
            return "in order"

    before = signal.getsignal(how)
    assert run_watched(work, look, stop.set) == ("in order", True)
    assert looks == [1]
    assert signal.getsignal(how) is before


def test_errors_of_the_work_and_of_the_watcher_are_raised_and_end_the_other() -> None:
    stop = threading.Event()

    def fail() -> None:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        run_watched(fail, lambda: None, stop.set)
    assert not stop.is_set()
    with pytest.raises(ValueError, match="broken"):
        run_watched(lambda: stop.wait(60), fail, stop.set)
    assert stop.is_set()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_ctrl_c_that_somebody_swallowed_is_not_lost(how: signal.Signals) -> None:
    before = signal.getsignal(how)
    with stop_signals() as pressed:
        pressed.check()
        with suppress(BaseException):
            signal.raise_signal(how)
        with pytest.raises(KeyboardInterrupt):
            pressed.check()
    assert signal.getsignal(how) is before
