"""How many more runs two workers fly than one: `python benchmarks/campaign_scaling.py`.

Wants two idle cores; what else runs on them counts against the second worker. Processes are started
and have flown a run each before the time is taken. How busy the machine was besides is shown: the
processor time that was to be had, over the time of all cores.

On a busy machine the wall says little. So the processor time of a run, all of our processes
together, is shown too: what two workers need more of it for a run than one does, is lost by us.
From that follows what they would be worth if each had a core to itself.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import command_line

from follower.simulation.campaign.config import RunSpec, load_campaign, planned
from follower.simulation.campaign.fly import fly_runs
from follower.workers import DaskEngine, Engine, LocalEngine

WANTED = 1.8


def main() -> None:
    """Measure, print, and fail if two workers are not worth it."""
    parser = command_line.parser(__doc__)
    parser.add_argument("--runs", type=command_line.count, default=24)
    parser.add_argument("--scheduler", help="also through this Dask scheduler")
    options = parser.parse_args()
    specs = planned(load_campaign("standard", vision="truth+noise", runs=options.runs))
    single = timed("one process", LocalEngine(1), specs)
    double = timed("two processes", LocalEngine(2), specs)
    worth = single.wall_s / double.wall_s
    print(f"two over one: {worth:.2f}, wanted {WANTED}")
    print(f"by processor time: {2 * single.processor_s / double.processor_s:.2f}")
    if options.scheduler:
        dask = timed("Dask", DaskEngine(options.scheduler), specs)
        print(f"Dask over one: {single.wall_s / dask.wall_s:.2f}")
    if worth < WANTED:
        raise SystemExit(1)


@dataclass(frozen=True, slots=True)
class Spent:
    """What some runs took, and the processors' time of ours in it."""

    wall_s: float
    processor_s: float


def timed(name: str, engine: Engine, specs: Sequence[RunSpec]) -> Spent:
    """Return what an engine takes for the runs."""
    warm = [replace(specs[0], number=-1 - n, scene=("duration_s=3",)) for n in range(2)]
    list(fly_runs(engine, warm))
    idle_s, own_s, begin_s = idle(), processor(), time.perf_counter()
    rows = list(fly_runs(engine, specs))
    took_s, own_s = time.perf_counter() - begin_s, processor() - own_s
    free = (idle() - idle_s) / (took_s * (os.cpu_count() or 1))
    engine.close()
    errors = [row["error"] for row in rows if row["error"]]
    if errors:
        raise SystemExit(errors[0])
    each = f"{own_s / len(specs):.2f} s of processor time a run"
    print(f"{name}: {len(specs) / took_s:.3f} runs/s, {each}, {100 * free:.0f} % of all cores idle")
    return Spent(took_s, own_s)


def processor() -> float:
    """Return the processor time of this process and of those that it began, in seconds."""
    numbers = [os.getpid(), *(one.pid for one in multiprocessing.active_children() if one.pid)]
    stats = [Path(f"/proc/{number}/stat").read_text(encoding="ascii") for number in numbers]
    ticks = [sum(map(int, stat.rpartition(")")[2].split()[11:13])) for stat in stats]
    return sum(ticks) / os.sysconf("SC_CLK_TCK")


def idle() -> float:
    """Return for how many seconds the cores have been idle since the start, taken together."""
    with Path("/proc/uptime").open(encoding="ascii") as file:
        return float(file.read().split()[1])


if __name__ == "__main__":
    command_line.run(main)
