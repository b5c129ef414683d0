"""Ctrl-C, a polite kill and a terminal that goes away end a flight in order."""

import select
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self, TextIO, TypeVar

from follower.flight.supervision.inputs import ConsentRequest

_ALWAYS = (signal.SIGINT, signal.SIGTERM)
_UNLESS_IGNORED = (signal.SIGHUP, signal.SIGQUIT)


def ending_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a flight: all that would kill it and can be caught.

    A program that ignores its terminal's end, as by nohup, goes on.
    """
    ignored = [one for one in _UNLESS_IGNORED if signal.getsignal(one) == signal.SIG_IGN]
    return (*_ALWAYS, *(one for one in _UNLESS_IGNORED if one not in ignored))


def _nothing() -> None:
    """Let what is being done come to its end."""


@contextmanager
def _handling(handle: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle the signals that end a flight; on another thread than the main one, do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[signal.Signals, Any] = {
        number: signal.signal(number, handle) for number in ending_signals()
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class StopOnInterrupt:
    """While entered, the first signal to end calls `stop`; the second Ctrl-C interrupts.

    A service manager's SIGTERM may come several times: those after the first change nothing.
    On another thread than the main one, which alone receives signals, this does nothing.
    Without `stop`, the first lets what is being done come to its end: for writing files.

    Attributes:
        interrupted: it happened.
    """

    def __init__(self, stop: Callable[[], None] = _nothing) -> None:
        self._stop = stop
        self._handling = _handling(self._handle)
        self.interrupted = False

    def __enter__(self) -> Self:
        self._handling.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._handling.__exit__(None, None, None)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self.interrupted:
            if number == signal.SIGINT:
                raise KeyboardInterrupt
            return
        self.interrupted = True
        self._stop()


ResultT = TypeVar("ResultT")

_CALL_EVERY_S = 0.1


def run_watched(
    work: Callable[[], ResultT], monitor: Callable[[], None], stop: Callable[[], None]
) -> tuple[ResultT, bool]:
    """Do `work` on a thread of its own and call `monitor` on this one ten times a second meanwhile.

    After a signal to end `stop` is called, after which the work is to end soon and in order. What
    this thread is doing then is done to its end: an exception thrown into it could leave a lock
    taken that the work waits for. The second Ctrl-C interrupts.

    Returns:
        The work's result, and whether it was interrupted.
    """
    with StopOnInterrupt() as asked, ThreadPoolExecutor(1, "work") as threads:
        future = threads.submit(work)
        try:
            while not asked.interrupted and wait([future], _CALL_EVERY_S).not_done:
                monitor()
        finally:
            if not future.done():
                stop()
        return future.result(), asked.interrupted


class InterruptFlag:
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
def stop_signals() -> Iterator[InterruptFlag]:
    """Let Ctrl-C and the other ending signals end the work, noted in the `InterruptFlag`."""
    pressed = InterruptFlag()
    with _handling(pressed.handle):
        yield pressed


class Keyboard:
    """Reads a terminal without ever waiting for it.

    Enter alone consents. Whatever else is typed withdraws, be it "n", "stop" or a slip: who types
    in a hurry wants the vehicle to end what it does. What is no terminal gives no orders: a
    service's input is at its end from the start.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream: TextIO | None = stream if _is_terminal(stream) else None

    def order(self) -> ConsentRequest:
        """Return what was typed since last time."""
        order = ConsentRequest.NONE
        while self._stream is not None and select.select([self._stream], [], [], 0)[0]:
            line = self._stream.readline()
            if not line:
                self._stream = None
            elif line.strip():
                order = ConsentRequest.WITHDRAW
            elif order is ConsentRequest.NONE:
                order = ConsentRequest.GIVE
        return order


def _is_terminal(stream: TextIO) -> bool:
    try:
        return stream.isatty()
    except ValueError:
        return False
