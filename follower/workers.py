"""Spreads jobs over processes here, or over the workers of a Dask scheduler."""

import faulthandler
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import connection, resource_tracker
from typing import Any, Generic, TypeVar, cast

import cv2
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from follower.ui.terminal.console import needed, print_line
from follower_control.common.interrupt import interrupted_later
from follower_control.common.strict_config import SettingsError

JobT = TypeVar("JobT")
ResultT = TypeVar("ResultT")

LONGEST_S = 1800.0
"""A job that takes longer hangs: its process is ended."""
_TRIES = 3
_STDERR = 2


class JobError(SettingsError):
    """What kept a job from being done, in one line."""


@dataclass(frozen=True, slots=True)
class Done(Generic[JobT, ResultT]):
    """A job with what came of it: a value, or the failure in one line."""

    job: JobT
    value: ResultT | None = None
    failure: str = ""

    @property
    def result(self) -> ResultT:
        """The value.

        Raises:
            JobError: the job failed.
        """
        if self.failure:
            raise JobError(self.failure)
        return cast(ResultT, self.value)


class Engine:
    """Does jobs in this process, one after the other; others of its kind do several at a time."""

    def run(
        self, do: Callable[[JobT], ResultT], jobs: Iterable[JobT]
    ) -> Iterator[Done[JobT, ResultT]]:
        """Yield each job once, when it is done, in whatever order.

        A job that raises has failed, and so has one that kills its process, if that is another
        one, or hangs in it; it stops no other.

        Args:
            do: does one; a function of a module, for it goes to other processes.
            jobs: what it is given, and what can be pickled.
        """
        for job in jobs:
            yield Done(job, *_attempt(do, job))

    def close(self) -> None:
        """End what it has begun."""


def engine_for(workers: int, dask: str | None, longest_s: float = LONGEST_S) -> Engine:
    """Return what does jobs: in this process (0 workers), in others, or on a Dask cluster.

    Raises:
        SettingsError: no scheduler answers at the address, or it has no workers.
    """
    if dask is not None:
        return DaskEngine(dask, longest_s)
    return LocalEngine(workers, longest_s) if workers else Engine()


def _attempt(do: Callable[[JobT], ResultT], job: JobT) -> tuple[ResultT | None, str]:
    """Do a job; return its value, and why there is none."""
    try:
        return do(job), ""
    except Exception as error:
        return None, describe_error(error)


def _attempt_in_time(
    do: Callable[[JobT], ResultT], longest_s: float, job: JobT
) -> tuple[ResultT | None, str]:
    """Do the same in a process that ends, and shows where it was, if that takes too long."""
    faulthandler.dump_traceback_later(longest_s, exit=True, file=_STDERR)
    try:
        return _attempt(do, job)
    finally:
        faulthandler.cancel_dump_traceback_later()


_CONNECT_S = 10


class DaskEngine(Engine):
    """A client of a running scheduler.

    Start `dask scheduler` on one machine and `dask worker ADDRESS --nthreads 1` on each, as often
    as it has cores; `follower` of the same version has to be installed there.

    Args:
        address: of the scheduler, e.g. "tcp://10.0.0.1:8786".
        longest_s: a worker that has a job for longer is ended.

    Raises:
        SettingsError: no scheduler answers there, no worker is there, or one does several jobs at a
            time in its process, where a job that hangs could not be told from the others.
    """

    def __init__(self, address: str, longest_s: float = LONGEST_S) -> None:
        self._address, self._longest_s = address, longest_s
        self._dask = needed("distributed")
        try:
            # A client that is refused its address by `Client` is closed at its end, for 20 s.
            self._dask.comm.get_address_host_port(address)
            self._client = self._dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SettingsError(
                f"--dask {address}: no scheduler answers ({describe_error(error)}); start one "
                "with `dask scheduler`"
            ) from None
        threads = self._client.nthreads().values()
        if not threads or max(threads) > 1:
            self._client.close()
            what = "a worker has several threads" if threads else "it has no workers"
            raise SettingsError(
                f"--dask {address}: {what}; start them with `dask worker {address} --nthreads 1`"
            )

    def run(
        self, do: Callable[[JobT], ResultT], jobs: Iterable[JobT]
    ) -> Iterator[Done[JobT, ResultT]]:
        """See `Engine`. Dask does what a dead worker had in hand on another one.

        Raises:
            SettingsError: the scheduler is gone.
        """
        attempt, blamed = partial(_attempt_in_time, do, self._longest_s), []
        for done in self._finished(attempt, list(jobs)):
            if done.failure.startswith(self._dask.KilledWorker.__name__):
                blamed.append(done.job)
            else:
                yield done
        # Dask blames each job that a dead worker held, not only the one that it was doing.
        for job in blamed:
            yield from self._finished(attempt, [job])

    def _finished(self, attempt: Callable[[JobT], Any], jobs: list[JobT]) -> Iterator[Any]:
        flying = dict(zip(self._client.map(attempt, jobs, pure=False), jobs, strict=True))
        for future in self._dask.as_completed(list(flying), loop=self._client.loop):
            if future.status in ("cancelled", "lost"):
                raise SettingsError(
                    f"--dask {self._address}: the scheduler is gone; what is finished is kept"
                )
            error = future.exception()
            answer = (None, describe_error(error)) if error else future.result()
            yield Done(flying.pop(future), *answer)
            future.release()

    def close(self) -> None:
        """Leave the scheduler; what was not finished is not done."""
        self._client.close()


class _Worker:
    """A process that does one job at a time.

    Ctrl-C goes to all processes of a terminal; what comes of it is for the first one to say. So the
    others begin with it blocked, before there is anything in them that could say something.
    """

    def __init__(self, longest_s: float) -> None:
        context = multiprocessing.get_context("spawn")  # not forked: threads do not survive that
        resource_tracker.ensure_running()  # begun within the first `start`, it would lift the block
        self.answers, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, longest_s), daemon=True)
        with interrupted_later():  # half begun, a process would end with a traceback
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                self._process.start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        theirs.close()

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self.answers.close()


class LocalEngine(Engine):
    """Processes here, one job each at a time.

    When one dies, or hangs and is ended, its job is tried again in a new one, and given up when
    three have died of it. Other jobs notice nothing of that.

    Args:
        workers: how many processes.
        longest_s: a process that has a job for longer is ended.
    """

    def __init__(self, workers: int, longest_s: float = LONGEST_S) -> None:
        self.workers = workers
        self._longest_s = longest_s
        self._idle: list[_Worker] = []

    def run(
        self, do: Callable[[JobT], ResultT], jobs: Iterable[JobT]
    ) -> Iterator[Done[JobT, ResultT]]:
        """See `Engine`."""
        waiting = deque((job, 1) for job in jobs)
        busy: dict[Any, tuple[_Worker, JobT, int]] = {}
        try:
            while waiting or busy:
                while waiting and len(busy) < self.workers:
                    worker = self._given(do, waiting[0][0])
                    busy[worker.answers] = worker, *waiting.popleft()
                for answers in connection.wait(list(busy)):
                    worker, job, tries = busy.pop(answers)
                    try:
                        done = Done(job, *worker.answers.recv())
                    except (EOFError, OSError):
                        worker.end()
                        if tries < _TRIES:
                            waiting.appendleft((job, tries + 1))
                            continue
                        why = f"its process died, or was ended after {self._longest_s:g} s"
                        done = Done(job, failure=f"{why}, {_TRIES} times")
                    else:
                        self._idle.append(worker)
                    yield done
        finally:
            for worker, _, _ in busy.values():
                worker.end()

    def _given(self, do: Callable[[JobT], ResultT], job: JobT) -> _Worker:
        """Return a worker that has the job: one that is idle and lives, or a new one."""
        while self._idle:
            worker = self._idle.pop()
            try:
                worker.answers.send((do, job))
            except OSError:
                worker.end()
            else:
                return worker
        worker = _Worker(self._longest_s)
        with suppress(OSError):  # it died at once, which its answer will show
            worker.answers.send((do, job))
        return worker

    def close(self) -> None:
        """End the processes; what they still do is lost."""
        while self._idle:
            self._idle.pop().end()


def _serve(jobs: Any, longest_s: float) -> None:
    """Do jobs as they come, in a process that lasts no longer than the one that gives them."""
    end_with_parent()
    cv2.setNumThreads(1)
    with suppress(EOFError):
        while True:
            do, job = jobs.recv()
            jobs.send(_attempt_in_time(do, longest_s, job))


def end_with_parent() -> None:
    """Let this process end when the one that began it is gone, however that ended."""
    parent = multiprocessing.parent_process()

    def wait_for_it() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_it, name="parent", daemon=True).start()


def describe_error(error: BaseException) -> str:
    """Return an error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


_LINE_EVERY_S, _PACE_OVER_S = 20.0, 3600.0


@contextmanager
def job_progress(
    console: Console, title: str, total: int, done: int = 0, things: str = "runs"
) -> Iterator[Callable[[], None]]:
    """Show a bar on a terminal, else a line now and then; yield what counts one more job.

    Args:
        console: where to.
        title: what is done.
        total: how many jobs there are.
        done: how many of them were finished before; the time to go does not count them.
        things: what they are.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    bar = Progress(
        *columns,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        speed_estimate_period=_PACE_OVER_S,
        disable=not console.is_terminal,
    )
    task = bar.add_task(title, total=total, completed=done)
    due_s = time.monotonic() + _LINE_EVERY_S

    def count_one() -> None:
        nonlocal due_s
        bar.advance(task)
        if bar.disable and time.monotonic() > due_s:
            due_s = time.monotonic() + _LINE_EVERY_S
            print_line(console, f"{bar.tasks[0].completed:.0f} of {total} {things}")

    with bar:
        yield count_one
