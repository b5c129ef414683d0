"""Ctrl-C, a polite kill and a terminal that goes away end a flight in order."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

_ALWAYS = (signal.SIGINT, signal.SIGTERM)
_UNLESS_IGNORED = (signal.SIGHUP, signal.SIGQUIT)


def ending_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a flight: all that would kill it and can be caught.

    A program that was told to ignore its terminal's end, as by nohup, goes on.
    """
    ignored = [one for one in _UNLESS_IGNORED if signal.getsignal(one) == signal.SIG_IGN]
    return (*_ALWAYS, *(one for one in _UNLESS_IGNORED if one not in ignored))


def _nothing() -> None:
    """Let what is being done come to its end."""


class StopOnInterrupt:
    """While entered, the first signal to end calls `stop`; the second Ctrl-C interrupts.

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
            self._before = {
                number: signal.signal(number, self._handle) for number in ending_signals()
            }
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
