"""A one-slot mailbox: the newest value between two threads, never a queue."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Keeps the newest value; a value that nobody took is overwritten and counted.

    Any number of threads may put, wait and read.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._newest: T | None = None
        self._fresh = False
        self._closed = False
        self._received = 0
        self._overwritten = 0

    def put(self, value: T) -> None:
        """Make `value` the newest. After `close` it is dropped."""
        with self._condition:
            if self._closed:
                return
            self._overwritten += self._fresh
            self._received += 1
            self._newest, self._fresh = value, True
            self._condition.notify_all()

    def wait(self, timeout_s: float | None = None) -> T | None:
        """Take the newest value that nobody has taken yet, waiting for one if need be.

        Returns:
            The value, or None after `timeout_s` seconds without one, or once the mailbox is
            closed and empty. With 0 it never waits; with None it waits for ever.
        """
        with self._condition:
            self._condition.wait_for(lambda: self._fresh or self._closed, timeout_s)
            if not self._fresh:
                return None
            self._fresh = False
            return self._newest

    def close(self) -> None:
        """Let every waiting thread go; a value not taken yet can still be taken."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()

    @property
    def newest(self) -> T | None:
        """The newest value, taken or not; None before the first."""
        with self._condition:
            return self._newest

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        with self._condition:
            return self._closed

    @property
    def received(self) -> int:
        """How many values were put."""
        with self._condition:
            return self._received

    @property
    def overwritten(self) -> int:
        """How many values were replaced before anybody took them."""
        with self._condition:
            return self._overwritten
