"""Flies the runs of a campaign: in processes here, or on the workers of a Dask scheduler."""

import multiprocessing
import os
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from importlib.metadata import version
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, Protocol

import cv2
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from follower.simulation.campaign.config import RunSpec
from follower.simulation.campaign.metrics import figures_of
from follower.simulation.components import FlightOptions
from follower.simulation.flight import SimulatedFlight
from follower.simulation.runners import fly_lockstep
from follower.ui.terminal.console import needed, print_line
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import MemoryTransport
from follower_sim.world.world import World
from follower_vision.clock import SimulatedClock


def fly_run(spec: RunSpec) -> dict[str, Any]:
    """Fly a run on this thread alone, and return its row: what it was, what came of it.

    Raises:
        SettingsError: the scenario or a setting cannot be used.
    """
    cv2.setNumThreads(1)
    begin_s = time.perf_counter()
    options = spec.options()
    scenario, settings = options.resolve()
    clock, ends = SimulatedClock(), MemoryTransport.pair()
    world, extras = World(scenario, spec.seed), FlightOptions(vision=options.vision)
    flight = SimulatedFlight(world, settings, spec.autopilot, clock, ends, extras)
    with closing(flight):
        fly_lockstep(flight, clock, lambda: None)
    figures = figures_of(flight).to_dict()
    return {**row_of(spec), **figures, "wall_s": time.perf_counter() - begin_s}


def row_of(spec: RunSpec, error: str = "") -> dict[str, Any]:
    """Return what is known of a run before it is flown."""
    return {
        "key": spec.key,
        "number": spec.number,
        "scenario": spec.scenario,
        "autopilot": spec.autopilot,
        "seed": spec.seed,
        "vision": spec.vision,
        "values": dict(spec.values),
        "command": spec.options().command,
        "version": version("drone-target-follower"),
        "error": error,
    }


class RunEngine(Protocol):
    """Flies runs, several at a time."""

    def fly(self, specs: Sequence[RunSpec]) -> Iterator[dict[str, Any]]:
        """Yield a row for each run as it is finished, in whatever order.

        A run that fails has a row that says why; it stops no other.
        """
        ...

    def close(self) -> None:
        """End what it has begun."""
        ...


_CONNECT_S = 10
_RETRIES = 3


class DaskEngine:
    """A client of a running scheduler.

    Start `dask scheduler` on one machine and `dask worker ADDRESS --nthreads 1` on each, as often
    as it has cores; `follower` of the same version has to be installed there.

    Args:
        address: of the scheduler, e.g. "tcp://10.0.0.1:8786".

    Raises:
        SettingsError: no scheduler answers there, or no worker is there.
    """

    def __init__(self, address: str) -> None:
        self._dask = needed("distributed")
        try:
            self._client = self._dask.Client(address, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise SettingsError(
                f"--scheduler {address}: no scheduler answers ({describe_error(error)}); start one "
                "with `dask scheduler`"
            ) from None
        if not self._client.nthreads():
            self._client.close()
            raise SettingsError(
                f"--scheduler {address}: it has no workers; start some with "
                f"`dask worker {address} --nthreads 1`"
            )

    def fly(self, specs: Sequence[RunSpec]) -> Iterator[dict[str, Any]]:
        """Yield a row for each run as it is finished.

        Dask flies what a dead worker had in hand on another one.
        """
        flying = {
            self._client.submit(fly_run, spec, pure=False, retries=_RETRIES): spec for spec in specs
        }
        for future in self._dask.as_completed(list(flying), loop=self._client.loop):
            spec = flying.pop(future)
            error = future.exception()
            yield row_of(spec, describe_error(error)) if error else future.result()
            future.release()

    def close(self) -> None:
        """Leave the scheduler; what was not finished is not flown."""
        self._client.close()


_TRIES = 3
_LINE_EVERY_S, _PACE_OVER_S = 20.0, 3600.0
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
                    yield row_of(spec, describe_error(error)) if error else future.result()
                    continue
                tries[spec.number] += 1
                if tries[spec.number] < _TRIES:
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

    def close(self) -> None:
        """End the processes; what they still fly is lost."""
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


def describe_error(error: BaseException) -> str:
    """Return an error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


@contextmanager
def campaign_progress(
    console: Console, title: str, total: int, flown: int = 0
) -> Iterator[Callable[[], None]]:
    """Show a bar on a terminal, else a line now and then; yield what counts one more run.

    Args:
        console: where to.
        title: what is flown.
        total: how many runs there are.
        flown: how many of them were finished before; the time to go does not count them.
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
    task = bar.add_task(title, total=total, completed=flown)
    due_s = time.monotonic() + _LINE_EVERY_S

    def count_one() -> None:
        nonlocal due_s
        bar.advance(task)
        if bar.disable and time.monotonic() > due_s:
            due_s = time.monotonic() + _LINE_EVERY_S
            print_line(console, f"{bar.tasks[0].completed:.0f} of {total} runs")

    with bar:
        yield count_one
