"""A one-slot mailbox: the newest value between two threads, never a queue."""

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Keeps the newest value; a value that was not taken is overwritten and counted.

    Any number of threads may put, wait and read.

    Attributes:
        newest: the newest value, taken or not; None before the first.
        closed: whether `close` was called.
        received: how many values were put.
        overwritten: how many values were replaced before anybody took them.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self.newest: T | None = None
        self._fresh = False
        self.closed = False
        self.received = 0
        self.overwritten = 0

    def put(self, value: T) -> None:
        """Make `value` the newest. After `close` it is dropped."""
        with self._condition:
            if self.closed:
                return
            self.overwritten += self._fresh
            self.received += 1
            self.newest, self._fresh = value, True
            self._condition.notify_all()

    def wait(self, timeout_s: float | None = None) -> T | None:
        """Take the newest value that was not taken yet, waiting for one if need be.

        Returns:
            The value, or None after `timeout_s` seconds without one, or once the mailbox is
            closed and empty. With 0 it never waits; with None it waits for ever.
        """
        with self._condition:
            self._condition.wait_for(lambda: self._fresh or self.closed, timeout_s)
            if not self._fresh:
                return None
            self._fresh = False
            return self.newest

    def close(self) -> None:
        """Let every waiting thread go; a value not taken yet can still be taken."""
        with self._condition:
            self.closed = True
            self._condition.notify_all()
