"""Runs work on a thread while somebody watches, and ends it well on Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, TypeVar

from follower.interrupt import StopOnInterrupt

ResultT = TypeVar("ResultT")

_LOOK_EVERY_S = 0.1


def run_watched(
    work: Callable[[], ResultT], look: Callable[[], None], stop: Callable[[], None]
) -> tuple[ResultT, bool]:
    """Do `work` on a thread of its own and call `look` on this one ten times a second meanwhile.

    After Ctrl-C or SIGTERM `stop` is called, after which the work is to end soon and in order. What
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


@contextmanager
def sigterm_as_ctrl_c() -> Iterator[None]:
    """Let a polite kill, such as a service manager's, end the work as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: Any = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
