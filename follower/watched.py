"""Runs work on a thread while somebody watches, and ends it well on Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, TypeVar

ResultT = TypeVar("ResultT")

_LOOK_EVERY_S = 0.1


def run_watched(
    work: Callable[[], ResultT], look: Callable[[], None], stop: Callable[[], None]
) -> tuple[ResultT, bool]:
    """Do `work` on a thread of its own and call `look` on this one ten times a second meanwhile.

    Ctrl-C, or SIGTERM within `sigterm_as_ctrl_c`, calls `stop`, after which the work is to end soon
    and in order.

    Returns:
        The work's result, and whether it was interrupted.
    """
    interrupted = False
    with ThreadPoolExecutor(1, "work") as threads:
        future = threads.submit(work)
        try:
            while wait([future], _LOOK_EVERY_S).not_done:
                look()
        except KeyboardInterrupt:
            interrupted = True
        finally:
            if not future.done():
                stop()
        return future.result(), interrupted


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
