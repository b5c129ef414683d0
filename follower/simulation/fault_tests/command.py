"""`follower faults`: the matrix of faults, and many random flights."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing, suppress
from itertools import chain, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from follower.settings.link import LINK_KINDS
from follower.simulation.faults.fault import (
    FLAVOURS,
    Fault,
    FaultSetup,
    catalogue,
    fault_named,
    in_groups,
)
from follower.ui.terminal.console import counted, print_line
from follower_control.common.strict_config import SettingsError

if TYPE_CHECKING:
    from follower.simulation.fault_tests.random_flight import FlightResult
    from follower.simulation.faults.judge import FaultVerdict
    from follower.workers import Engine

_NICE = 10
_FAILED = 1
RESULTS, TALLY = "results.json", "random.json"
EPILOG = """
**Examples**

`follower faults list` – the catalogue

`follower faults frames-black --autopilot px4` – one fault with one autopilot

`follower faults --random 20 --seed 3` – twenty random flights with random faults
"""

Names = Annotated[
    list[str] | None,
    typer.Argument(help="Faults of the catalogue, all by default; **list** shows them."),
]
Autopilot = Annotated[
    str, typer.Option(metavar="px4|ardupilot|both", help="Which one is simulated.")
]
LinkKind = Annotated[
    str,
    typer.Option(
        "--link", metavar="|".join((*LINK_KINDS, "both")), help="mavsdk flies in real time alone."
    ),
]
RealtimeFlag = Annotated[
    bool, typer.Option("--realtime", help="Threads and UDP in place of lockstep.")
]
RandomFlights = Annotated[
    int,
    typer.Option("--random", min=0, help="Fly so many more random flights in place of the matrix."),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the random flights.")]
Only = Annotated[
    int | None, typer.Option("--only", min=0, help="Fly the random flight of this number alone.")
]
Out = Annotated[Path, typer.Option(help="Where results are kept from run to run.")]
Workers = Annotated[
    int, typer.Option(min=0, help="Processes that fly; 0: this one. Real time flies one by one.")
]
Dask = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Fly on this Dask scheduler's workers.")
]


def faults_command(
    names: Names = None,
    autopilot: Autopilot = "both",
    link: LinkKind = "pymavlink",
    realtime: RealtimeFlag = False,
    random: RandomFlights = 0,
    seed: Seed = 0,
    only: Only = None,
    out: Out = Path("runs/faults"),
    workers: Workers = 0,
    dask: Dask = None,
) -> None:
    """Put faults into simulated flights and judge what comes of them.

    Without options: every fault of the catalogue, with both autopilots, on a simulated clock. An
    independent watcher sees what goes over the wire and how the vehicle moves. The exit code is 1
    if anything is not as it must be.
    """
    console = Console()
    if names == ["list"]:
        list_faults(console)
        return
    if names and (random or only is not None):
        raise SettingsError(f"{names[0]}: random flights draw faults of their own; give no names")
    if only is not None:
        raise typer.Exit(_FAILED if _fly_one(console, seed, only) else 0)
    from follower.workers import engine_for

    if random:
        with suppress(OSError):
            os.nice(_NICE)
    with closing(engine_for(workers, dask)) as engine:
        if random:
            failed = _fly_random(console, engine, random, seed, out / TALLY)
        else:
            cases = list(_cases(list(names or ()), autopilot, link, realtime))
            failed = _fly_matrix(console, engine, cases, out / RESULTS)
    raise typer.Exit(_FAILED if failed else 0)


def list_faults(console: Console | None = None) -> None:
    """Show all faults with what must come of them."""
    table = Table(box=None)
    for title in ("fault", "lasts", "with", "what must happen"):
        table.add_column(title, overflow="fold")
    for group, faults in in_groups().items():
        table.add_row(f"[bold]{group}[/bold]")
        for fault in faults:
            lasts = "on" if fault.for_s == float("inf") else f"{fault.for_s:g} s"
            table.add_row(fault.name, lasts, applies_to(fault), fault.must)
    (console or Console()).print(table)


def applies_to(fault: Fault) -> str:
    """Return with which autopilots and links a fault can come about, "all" for all of them."""
    limited = [
        ", ".join(here)
        for here, known in ((fault.flavours, FLAVOURS), (fault.links, LINK_KINDS))
        if here != known
    ]
    clock = [] if fault.lockstep else ["in real time"]
    return "; ".join((*limited, *clock)) or "all"


_Case = tuple[Fault, FaultSetup]


def fly_case(case: _Case) -> FaultVerdict:
    """Fly a case."""
    import cv2

    from follower.simulation.fault_tests.run_fault import fly_fault

    cv2.setNumThreads(1)
    return fly_fault(*case)


def _fly_matrix(console: Console, engine: Engine, cases: list[_Case], path: Path) -> bool:
    """Fly the cases, those in real time one after the other; return whether any failed."""
    from follower.simulation.fault_tests.results import FaultResult, Results
    from follower.simulation.faults.judge import FaultMetrics, FaultVerdict
    from follower.workers import Engine

    results = Results(path)
    failed = 0
    lockstep = [case for case in cases if not case[1].realtime]
    slow = [case for case in cases if case[1].realtime]
    flown = chain(engine.run(fly_case, lockstep), Engine().run(fly_case, slow))
    for number, done in enumerate(flown, 1):
        fault, setup = done.job
        verdict = done.value or FaultVerdict(
            fault.name, fault.must, (done.failure,), FaultMetrics(), "not flown"
        )
        result = FaultResult(*setup, verdict)
        results.add(result)
        failed += not result.verdict.passed
        mark, style = ("ok  ", "green") if result.verdict.passed else ("FAIL", "red")
        print_line(console, f"{number:3}/{len(cases)} {mark} {result.key}", style)
        for failure in result.verdict.failures:
            print_line(console, f"         {failure}")
    print_line(
        console, f"{counted(len(cases), 'case')}, {failed} failed; all results are in {path}"
    )
    return failed > 0


def _cases(names: list[str], autopilot: str, link: str, realtime: bool) -> Iterator[_Case]:
    flavours = _chosen("--autopilot", autopilot, FLAVOURS)
    links = _chosen("--link", link, LINK_KINDS)
    chosen = [fault_named(name) for name in names] or list(catalogue())
    setups = [
        FaultSetup(flavour, kind, realtime or kind == "mavsdk")
        for kind, flavour in product(links, flavours)
    ]
    for fault in chosen:
        flown = [(fault, setup) for setup in setups if fault.flies(setup)]
        if names and not flown:
            raise SettingsError(
                f"{fault.name} cannot come about so, only with: {applies_to(fault)}; "
                "choose --realtime, --autopilot and --link"
            )
        yield from flown


def _chosen(option: str, value: str, known: tuple[str, ...]) -> tuple[str, ...]:
    if value == "both":
        return known
    if value not in known:
        raise SettingsError(f"{option} {value}: choose {', '.join(known)} or both")
    return (value,)


def _fly_one(console: Console, seed: int, number: int) -> bool:
    """Fly one random flight again; return whether it failed."""
    from follower.simulation.fault_tests.random_flight import fly_random

    result = fly_random((seed, number))
    print_line(console, result.failure or f"flight {number} is as it must be: {result.steps} steps")
    return bool(result.failure)


def fly_timed(number: tuple[int, int]) -> tuple[FlightResult, float]:
    """Fly a random flight of a seed and a number, and return how long it took too, in seconds."""
    from follower.flight.log import Stopwatch
    from follower.simulation.fault_tests.random_flight import fly_random

    timer = Stopwatch()
    return fly_random(number), timer.elapsed_s()


def _fly_random(console: Console, engine: Engine, flights: int, seed: int, path: Path) -> bool:
    """Fly random flights; return whether any failed."""
    from follower.simulation.fault_tests.random_flight import FlightResult
    from follower.simulation.fault_tests.results import Tally
    from follower.workers import job_progress

    tally = Tally.load(path, seed)
    numbers = [(seed, tally.flights + more) for more in range(flights)]
    early: dict[int, tuple[FlightResult, float]] = {}  # the tally goes by number, without gaps
    with job_progress(console, "flights", flights, things="flights") as count_one:
        for done in engine.run(fly_timed, numbers):
            early[done.job[1]] = done.value or (FlightResult(failure=done.failure), 0.0)
            while tally.flights in early:
                tally.add(*early.pop(tally.flights))
                tally.save(path)
            count_one()
    print_line(
        console,
        f"{counted(tally.flights, 'flight')}, {tally.minutes:.0f} min, {tally.steps} control "
        f"steps, {counted(len(tally.failures), 'failure')}; all results are in {path}",
    )
    for number, failure in tally.failures.items():
        print_line(console, f"flight {number}: {failure}")
    return bool(tally.failures)
