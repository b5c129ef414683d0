"""Runs work on a thread while somebody watches, and ends it well on Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

from follower.interrupt import StopOnInterrupt, ending_signals

ResultT = TypeVar("ResultT")

_LOOK_EVERY_S = 0.1


def run_watched(
    work: Callable[[], ResultT], look: Callable[[], None], stop: Callable[[], None]
) -> tuple[ResultT, bool]:
    """Do `work` on a thread of its own and call `look` on this one ten times a second meanwhile.

    After a signal to end `stop` is called, after which the work is to end soon and in order. What
    this thread is doing then is done to its end: an exception thrown into it could leave a lock
    taken that the work waits for. The second Ctrl-C interrupts.

    Returns:
        The work's result, and whether it was interrupted.
    """
    with StopOnInterrupt() as asked, ThreadPoolExecutor(1, "work") as threads:
        future = threads.submit(work)
        try:
            while not asked.interrupted and wait([future], _LOOK_EVERY_S).not_done:
                look()
        finally:
            if not future.done():
                stop()
        return future.result(), asked.interrupted


class Pressed:
    """Whether Ctrl-C was pressed, also where the exception was lost.

    Libraries that catch everything, while they are imported or opened, catch Ctrl-C too.
    """

    def __init__(self) -> None:
        self._asked = False

    def check(self) -> None:
        """Raise what was lost.

        Raises:
            KeyboardInterrupt: Ctrl-C was pressed.
        """
        if self._asked:
            raise KeyboardInterrupt

    def handle(self, _number: int, _frame: FrameType | None) -> None:
        """Take a signal."""
        self._asked = True
        raise KeyboardInterrupt


@contextmanager
def stop_signals() -> Iterator[Pressed]:
    """Let Ctrl-C end the work, kept in mind as `Pressed`, and the other signals that end it."""
    pressed = Pressed()
    if threading.current_thread() is not threading.main_thread():
        yield pressed
        return
    before: dict[signal.Signals, Any] = {
        number: signal.signal(number, pressed.handle) for number in ending_signals()
    }
    try:
        yield pressed
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
