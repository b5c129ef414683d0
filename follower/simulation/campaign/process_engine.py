"""Flies runs in processes on this machine, and goes on when one of them is killed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from follower.campaign.flying import fly_run, row_of
from follower.campaign.run_spec import RunSpec

_TRIES = 3
_Flights = dict[Future[dict[str, Any]], RunSpec]


class _Worker(SpawnProcess):
    """A process of the pool.

    Ctrl-C goes to all processes of a terminal; what comes of it is for the first one to say. So the
    others begin with it blocked, before there is anything in them that could say something.
    """

    def start(self) -> None:
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


class _Context(SpawnContext):
    Process = _Worker


class LocalEngine:
    """A pool of processes, one run each at a time.

    When the system kills a process, the pool is made anew and what it had in hand is flown again; a
    run whose process died three times is given up.

    Args:
        workers: how many processes.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._flying: _Flights = {}

    def fly(self, specs: Sequence[RunSpec]) -> Iterator[dict[str, Any]]:
        """Yield a row for each run as it is finished."""
        waiting, tries = deque(specs), Counter[int]()
        flying = self._flying = {}
        while waiting or flying:
            # Little more is handed out than is flown: what a dead pool had in hand is tried again.
            while waiting and len(flying) < self.workers + 1:
                spec = waiting.popleft()
                flying[self._submit(spec)] = spec
            done, _ = wait(flying, return_when=FIRST_COMPLETED)
            for future in done:
                spec = flying.pop(future)
                error = future.exception()
                if not isinstance(error, BrokenProcessPool):
                    yield row_of(spec, said_of(error)) if error else future.result()
                elif self._is_worth_another(spec, tries):
                    waiting.appendleft(spec)
                else:
                    yield row_of(spec, f"its process died {_TRIES} times")

    def _submit(self, spec: RunSpec) -> Future[dict[str, Any]]:
        """Hand out a run; to a new pool if the last one is broken."""
        if self._pool is not None:
            try:
                return self._pool.submit(fly_run, spec)
            except BrokenProcessPool:
                self._pool.shutdown(wait=False)
        self._pool = ProcessPoolExecutor(
            self.workers, mp_context=_Context(), initializer=end_with_parent
        )
        return self._pool.submit(fly_run, spec)

    def _is_worth_another(self, spec: RunSpec, tries: Counter[int]) -> bool:
        tries[spec.number] += 1
        return tries[spec.number] < _TRIES

    def close(self) -> None:
        """End the processes; what they still have in hand, nobody waits for."""
        if self._pool is None:
            return
        self._pool.shutdown(wait=not self._flying, cancel_futures=True)
        for child in multiprocessing.active_children():
            if isinstance(child, _Worker):
                child.kill()


def end_with_parent() -> None:
    """Let this process end when the one that began it is gone, however that ended."""
    parent = multiprocessing.parent_process()

    def wait_for_it() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_it, name="parent", daemon=True).start()


class InlineEngine:
    """Flies runs here, one after the other, without any process."""

    workers = 1

    def fly(self, specs: Sequence[RunSpec]) -> Iterator[dict[str, Any]]:
        """Yield a row for each run as it is finished; what fails is raised."""
        yield from (fly_run(spec) for spec in specs)

    def close(self) -> None:
        """Do nothing: nothing was begun."""


def said_of(error: BaseException) -> str:
    """Return an error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
