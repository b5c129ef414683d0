"""What many flights cost beside their flying: memory, transfer, the Dask scheduler's time.

    python benchmarks/many_flights.py [--flights 200] [--queued 10 100 1000]

Flies so many runs of the standard campaign, without pixels and a second long, one after the other
in this process, and says by how much its memory grows with each after the first fifth. Then it
starts a Dask scheduler with two workers, each a process of its own, and queues so many runs that
are not flown but answered at once with a flown one's row: what is left is the cost of spreading
them. "Scheduler" is its processor time, "sent" a run with its answer as they are pickled.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import command_line
import numpy as np
from rich.progress import track as progress

from follower.simulation.campaign.config import RunSpec, load_campaign, planned
from follower.simulation.campaign.fly import fly_run, fly_runs
from follower.workers import DaskEngine, Engine

BEGIN_S = 60.0


def main() -> None:
    """Measure and print."""
    parser = command_line.parser(__doc__)
    parser.add_argument("--flights", type=int, default=200, help="for the memory")
    parser.add_argument(
        "--queued", type=command_line.count, nargs="*", default=[10, 100, 1000], help="for Dask"
    )
    options = parser.parse_args()
    most = max([options.flights, *options.queued])
    specs = [
        replace(spec, scene=(*spec.scene, "duration_s=1"))
        for spec in planned(load_campaign("standard", vision="truth+noise", runs=most))
    ]
    if options.flights:
        memory(specs[: options.flights])
    if options.queued:
        queue(specs, options.queued)


def memory(specs: Sequence[RunSpec]) -> None:
    """Fly runs, and print how the resident memory grows."""
    grown = []
    for row in progress(fly_runs(Engine(), specs), "flights", total=len(specs)):
        if row["error"]:
            raise SystemExit(row["error"])
        grown.append(resident_bytes() / 1e6)
    settled = grown[len(grown) // 5 :]
    slope = float(np.polyfit(np.arange(len(settled)), settled, 1)[0])
    print(
        f"{len(specs)} flights: {settled[0]:.0f} MB at first, {settled[-1]:.0f} MB at the end, "
        f"{1000 * slope:+.1f} kB a flight"
    )


def resident_bytes() -> int:
    """Return the memory that this process has in the machine's."""
    pages = Path("/proc/self/statm").read_text("ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def queue(specs: Sequence[RunSpec], counts: Sequence[int]) -> None:
    """Print what a Dask scheduler needs for a run, by how many are queued."""
    row = fly_run(specs[0])
    sent = len(pickle.dumps(specs[0])) + len(pickle.dumps(row))
    print(f"{sent / 1000:.1f} kB sent a run, its answer included")
    with cluster() as (address, pid), closing(DaskEngine(address)) as engine:
        list(engine.run(partial(answered, row=row), specs[:2]))
        for count in counts:
            begin_s, busy_s = time.perf_counter(), processor_s(pid)
            rows = list(engine.run(partial(answered, row=row), specs[:count]))
            took_s, busy_s = time.perf_counter() - begin_s, processor_s(pid) - busy_s
            if any(one.failure for one in rows) or len(rows) != count:
                raise SystemExit("not every run was answered")
            print(
                f"{count:6} queued: scheduler {1000 * busy_s / count:6.2f} ms a run, "
                f"all {1000 * took_s / count:6.2f} ms by the wall"
            )


def answered(spec: RunSpec, row: dict[str, Any]) -> dict[str, Any]:
    """Return a row as if the run had been flown."""
    return {**row, "key": spec.key}


@contextmanager
def cluster() -> Iterator[tuple[str, int]]:
    """Start a scheduler and two workers; yield its address and process."""
    dask = [sys.executable, "-m", "dask"]
    start = partial(subprocess.Popen[bytes], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        where = ["--scheduler-file", str(file), "--no-dashboard"]
        started = [start([*dask, "scheduler", *where, "--host", "127.0.0.1", "--port", "0"])]
        try:
            end_s = time.monotonic() + BEGIN_S
            while not file.exists() and time.monotonic() < end_s:
                time.sleep(0.1)
            worker = [*dask, "worker", *where, "--nthreads", "1", "--nworkers", "2"]
            started.append(start([*worker, "--local-directory", folder]))
            address = json.loads(file.read_text("utf-8"))["address"]
            wait_for_workers(address, 2)
            yield address, started[0].pid
        finally:
            for process in reversed(started):
                process.terminate()
                process.wait()


def wait_for_workers(address: str, count: int) -> None:
    """Wait until so many workers have come."""
    import distributed

    with distributed.Client(address, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        client.wait_for_workers(count, timeout=BEGIN_S)


def processor_s(pid: int) -> float:
    """Return the processor time of a process, in seconds."""
    stat = Path(f"/proc/{pid}/stat").read_text("ascii")
    return sum(map(int, stat.rpartition(")")[2].split()[11:13])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    command_line.run(main)
