"""Ctrl-C, put off while something must come to its end."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interrupted_later() -> Iterator[None]:
    """Put a Ctrl-C off to the end of the block.

    A mask of signals alone does not: another thread of this process may receive the signal for the
    main one. On another thread than that, which Ctrl-C never interrupts, nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: caught.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)
    if caught:
        signal.raise_signal(signal.SIGINT)
