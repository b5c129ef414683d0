"""How many more runs two workers fly than one: `python benchmarks/campaign_scaling.py`.

Wants two idle cores; what else runs on them counts against the second worker. Processes are started
and have flown a run each before the time is taken. How busy the machine was besides is shown: the
processor time that was to be had, over the time of all cores.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from follower.campaign.campaign_config import load_campaign
from follower.campaign.dask_engine import DaskEngine
from follower.campaign.engine import Engine
from follower.campaign.local_engine import LocalEngine
from follower.campaign.plan import planned
from follower.campaign.run_spec import RunSpec

WANTED = 1.8


def main() -> None:
    """Measure, print, and fail if two workers are not worth it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--scheduler", help="also through this Dask scheduler")
    options = parser.parse_args()
    specs = planned(load_campaign("standard", vision="truth+noise", runs=options.runs))
    single = timed("one process", LocalEngine(1), specs)
    double = timed("two processes", LocalEngine(2), specs)
    print(f"two over one: {single / double:.2f}, wanted {WANTED}")
    if options.scheduler:
        dask = timed("Dask", DaskEngine(options.scheduler), specs)
        print(f"Dask over one: {single / dask:.2f}")
    if single / double < WANTED:
        raise SystemExit(1)


def timed(name: str, engine: Engine, specs: Sequence[RunSpec]) -> float:
    """Return the seconds that an engine takes for the runs."""
    warm = [replace(specs[0], number=-1 - n, scene=("duration_s=3",)) for n in range(2)]
    list(engine.fly(warm))
    idle_s, begin_s = idle(), time.perf_counter()
    rows = list(engine.fly(specs))
    took_s = time.perf_counter() - begin_s
    free = (idle() - idle_s) / (took_s * (os.cpu_count() or 1))
    engine.close()
    errors = [row["error"] for row in rows if row["error"]]
    if errors:
        raise SystemExit(errors[0])
    print(f"{name}: {len(specs) / took_s:.3f} runs/s, {100 * free:.0f} % of all cores idle")
    return took_s


def idle() -> float:
    """Return for how many seconds the cores have been idle since the start, taken together."""
    with Path("/proc/uptime").open(encoding="ascii") as file:
        return float(file.read().split()[1])


if __name__ == "__main__":
    main()
