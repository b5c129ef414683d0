"""Does two things at once, with the same result as one after the other."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar

Answer = TypeVar("Answer")


class Aside(Generic[Answer]):
    """A thread that works on one thing while its owner does another.

    Both have to spend their time outside Python to gain anything: OpenCV, numpy and onnxruntime do.
    """

    def __init__(self) -> None:
        self._pool: ThreadPoolExecutor | None = None
        self._begun: tuple[Future[Answer], Callable[[], Answer]] | None = None

    def begin(self, work: Callable[[], Answer]) -> None:
        """Begin to work; `end` has to be called before the next.

        What the owner does meanwhile may not depend on it, nor the work on what the owner does.
        """
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, "aside")
        self._begun = self._pool.submit(work), work

    def end(self) -> Answer:
        """Return what the work returns, or raise what it raises; wait for it if need be.

        Raises:
            RuntimeError: nothing was begun.
        """
        if self._begun is None:
            raise RuntimeError("nothing was begun")
        (future, work), self._begun = self._begun, None
        # On a busy machine the thread may not have had its turn: then it is quicker to do it here.
        return work() if future.cancel() else future.result()

    def close(self) -> None:
        """Let go of the thread; the next `begin` makes another."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
