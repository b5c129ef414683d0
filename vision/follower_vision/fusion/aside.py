"""Does two things at once, with the same result as one after the other."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from functools import partial
from queue import Empty, SimpleQueue
from typing import Generic, NoReturn, TypeVar

Answer = TypeVar("Answer")


class Aside(Generic[Answer]):
    """A thread that works on one thing while its owner does another.

    Both have to spend their time outside Python to gain anything: OpenCV, numpy and onnxruntime do.
    Two bare queues take a third of the time of a `concurrent.futures` pool, twice in every frame.
    """

    def __init__(self, afterwards: Callable[[], object] | None = None) -> None:
        """Make one; the thread itself is made by the first `begin`.

        Args:
            afterwards: what the thread does each time when it has answered, while nobody waits;
                what it raises, the thread's next answer raises.
        """
        self._afterwards = afterwards
        self._thread: threading.Thread | None = None
        self._todo: SimpleQueue[Callable[[], Answer] | None] = SimpleQueue()
        self._done: SimpleQueue[Callable[[], Answer]] = SimpleQueue()
        self._begun = False

    def begin(self, work: Callable[[], Answer]) -> None:
        """Begin to work; `end` has to be called before the next.

        What the owner does meanwhile may not depend on it, nor the work on what the owner does.
        """
        if self._thread is None:
            self._thread = self._started()
        self._begun = True
        self._todo.put(work)

    def end(self) -> Answer:
        """Return what the work returns, or raise what it raises; wait for it if need be.

        Raises:
            RuntimeError: nothing was begun.
        """
        if not self._begun:
            raise RuntimeError("nothing was begun")
        self._begun = False
        try:
            # On a busy machine the thread may not have had its turn: then it is quicker to do it
            # here.
            work = self._todo.get_nowait()
        except Empty:
            work = None
        return self._done.get()() if work is None else work()

    def close(self) -> None:
        """Let go of the thread; the next `begin` makes another."""
        if self._thread is not None:
            self._todo.put(None)
            self._thread.join()
            self._thread = None

    def _started(self) -> threading.Thread:
        given = self._todo, self._done, self._afterwards
        thread = threading.Thread(target=_serve, args=given, name="aside", daemon=True)
        thread.start()
        # An owner that is forgotten without being closed leaves no thread behind.
        weakref.finalize(self, self._todo.put, None)
        return thread


def _serve(
    todo: SimpleQueue[Callable[[], Answer] | None],
    done: SimpleQueue[Callable[[], Answer]],
    afterwards: Callable[[], object] | None,
) -> None:
    ready: Callable[[], object] = _nothing
    while (work := todo.get()) is not None:
        done.put(_outcome(partial(_after, ready, work)))
        if afterwards is not None:
            ready = _outcome(afterwards)


def _nothing() -> None:
    """Nothing was done yet that could have failed."""


def _after(ready: Callable[[], object], work: Callable[[], Answer]) -> Answer:
    ready()
    return work()


def _outcome(work: Callable[[], Answer]) -> Callable[[], Answer]:
    """Do the work, and return how to get at what it returned or raised."""
    try:
        answer = work()
    except BaseException as error:  # whoever asks for the outcome raises it again
        return _raising(error)
    return lambda: answer


def _raising(error: BaseException) -> Callable[[], NoReturn]:
    def fail() -> NoReturn:
        raise error

    return fail
