"""Ctrl-C and a polite kill end a flight in order."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _nothing() -> None:
    """Let what is being done come to its end."""


class StopOnInterrupt:
    """While entered, the first Ctrl-C or SIGTERM calls `stop`; the second Ctrl-C interrupts.

    A service manager's SIGTERM may come several times: those after the first change nothing.
    On another thread than the main one, which alone is told of signals, this does nothing.
    Without `stop`, the first lets what is being done come to its end: for writing files.

    Attributes:
        interrupted: it happened.
    """

    def __init__(self, stop: Callable[[], None] = _nothing) -> None:
        self._stop = stop
        self._before: dict[signal.Signals, Any] = {}
        self.interrupted = False

    def __enter__(self) -> StopOnInterrupt:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._handle) for number in _SIGNALS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self.interrupted:
            if number == signal.SIGINT:
                raise KeyboardInterrupt
            return
        self.interrupted = True
        self._stop()
