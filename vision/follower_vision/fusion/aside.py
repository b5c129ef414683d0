"""Does two things at once, with the same result as one after the other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Answer = TypeVar("Answer")


class Aside:
    """A thread that works on one thing while its owner does another.

    Both have to spend their time outside Python to gain anything: OpenCV, numpy and onnxruntime do.
    """

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None

    def during(self, meanwhile: Callable[[], None], work: Callable[[], Answer]) -> Answer:
        """Return what `work` returns; `meanwhile` runs at the same time, in the caller's thread.

        Neither may depend on what the other does. What they raise is raised here.
        """
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, "aside")
        future = self._pool.submit(work)
        meanwhile()
        # On a busy machine the thread may not have had its turn: then it is quicker to do it here.
        return work() if future.cancel() else future.result()

    def close(self) -> None:
        """Let go of the thread; the next `during` makes another."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
