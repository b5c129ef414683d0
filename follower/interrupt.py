"""Ctrl-C and a polite kill end a flight in order."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopOnInterrupt:
    """While entered, the first Ctrl-C or SIGTERM calls `stop`; the second Ctrl-C interrupts.

    A service manager's SIGTERM may come several times: those after the first change nothing.

    Attributes:
        interrupted: it happened.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self._before: list[Any] = []
        self.interrupted = False

    def __enter__(self) -> StopOnInterrupt:
        self._before = [signal.signal(number, self._handle) for number in _SIGNALS]
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, before in zip(_SIGNALS, self._before, strict=True):
            signal.signal(number, before)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self.interrupted:
            if number == signal.SIGINT:
                raise KeyboardInterrupt
            return
        self.interrupted = True
        self._stop()
