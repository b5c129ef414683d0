"""Flies scenarios on autopilots, one after the other, and reports on all of them."""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

from rich.console import Console

from follower.flight.supervision.flight_end import FAILED, INTERRUPTED, SUCCESS
from follower.links.connections import ConnectionFailedError
from follower.recording.run_folder import new_run_folder, remove_run_folder
from follower.report import flight_page, html
from follower.report.flight_page import REPORT, SCORE
from follower.report.html import Cell, Html
from follower.report.series import ReportMeta
from follower.settings.link import LINK_KINDS, is_link, link_kinds
from follower.settings.settings import find_scenario, scenario_files
from follower.simulation.campaign.config import load_campaign, planned
from follower.simulation.options import EXTERNAL, SimulationOptions, VisionSource
from follower.simulation.run import simulate
from follower.simulation.sitl.programs import (
    ArduCopterProgram,
    Px4Program,
    SimulatedProgram,
    SitlProgram,
    SitlSetup,
    read_parameters,
)
from follower.ui.terminal.cli_options import typed_command
from follower.ui.terminal.console import counted, print_line
from follower_control.common.strict_config import SettingsError
from follower_sim.scenario.scenario_file import load_scenario
from follower_vision.disk import write_whole

RESULTS = "results.json"
ALL = "all"
RANDOM_CAMPAIGN = "standard"
_FIGURES = (
    ("In frame", "in_frame_share", "{:.1%}"),
    ("LOS, RMS", "line_of_sight_rms_deg", "{:.2f}°"),
    ("LOS, box", "line_of_sight_box_rms_seen_deg", "{:.2f}°"),
    ("Range error", "range_error_median", "{:.1%}"),
    ("Approach", "approach_s", "{:.1f} s"),
    ("Searches begun", "losses", "{:d}"),
)


@dataclass(frozen=True, slots=True)
class SitlMatrix:
    """What the command line was given; see `follower sitl --help`."""

    scenarios: tuple[str, ...]
    programs: tuple[SitlProgram | None, ...]
    link: str = "pymavlink"
    repeat: int = 1
    seed: int | None = None
    speedup: float = 1.0
    parameter_file: Path | None = None
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    vision: VisionSource = VisionSource.PIXELS
    scene: tuple[str, ...] = ()
    video: bool = True
    connect: str | None = None
    random: int = 0

    def flights(self) -> Iterator[SimulationOptions]:
        """Yield every flight, without the folder it goes to.

        Raises:
            SettingsError: an option, a scenario or a parameter file cannot be used.
        """
        if self.link != "both" and not is_link(self.link):
            raise SettingsError(f"--link {self.link}: choose {', '.join(link_kinds())} or both")
        if bool(self.scenarios) == bool(self.random):
            raise SettingsError("name scenarios, or give --random with their number")
        for program in self.programs:
            setup = self._setup(program)
            for link in LINK_KINDS if self.link == "both" else (self.link,):
                for name, seed, scene in self._scenes():
                    yield SimulationOptions(
                        name,
                        EXTERNAL,
                        seed,
                        config=self.config,
                        overrides=self.overrides,
                        video=self.video,
                        connect=self.connect,
                        link=link,
                        vision=self.vision,
                        scene=(*scene, *self.scene),
                        program=program,
                        setup=setup,
                    )

    def _scenes(self) -> Iterator[tuple[str, int | None, tuple[str, ...]]]:
        """Yield scenario, seed and keys of each flight; random ones as the campaign draws them."""
        if self.random:
            drawn = load_campaign(RANDOM_CAMPAIGN, runs=self.random, seed=self.seed)
            for spec in planned(drawn):
                yield spec.scenario, spec.seed, spec.scene
            return
        for name in _all_scenarios() if ALL in self.scenarios else self.scenarios:
            for seed in self._seeds(name):
                yield name, seed, ()

    def _setup(self, program: SitlProgram | None) -> SitlSetup:
        if program is None:
            if self.speedup != 1.0 or self.parameter_file is not None:
                option = "--params" if self.speedup == 1.0 else "--speedup"
                raise SettingsError(f"{option}: an autopilot that runs already has its own")
            return SitlSetup()
        file = self.parameter_file
        parameters = program.usual_parameters() if file is None else read_parameters(file)
        return SitlSetup(self.speedup, parameters, file)

    def _seeds(self, name: str) -> Iterator[int | None]:
        first = self.seed
        if first is None and self.repeat > 1:
            first = load_scenario(find_scenario(name)).seed
        for number in range(self.repeat):
            yield None if first is None else first + number


def programs(
    arducopter: Path | None, px4: Path | None, simulated: str | None, connect: str | None
) -> tuple[SitlProgram | None, ...]:
    """Return the programs to be started, None for one that runs already.

    The environment's ARDUCOPTER_SITL and PX4_SITL count where the command line names none.

    Raises:
        SettingsError: none is named, or one is not what it is said to be.
    """
    named = arducopter or px4 or simulated
    if connect is not None:
        if named:
            raise SettingsError("--connect flies one that runs already: name no program with it")
        return (None,)
    if not named:
        arducopter, px4 = _environment("ARDUCOPTER_SITL"), _environment("PX4_SITL")
    found: list[SitlProgram] = []
    found += [] if arducopter is None else [ArduCopterProgram(arducopter)]
    found += [] if px4 is None else [Px4Program(px4)]
    found += [] if simulated is None else [SimulatedProgram(simulated)]
    if not found:
        raise SettingsError(
            "no autopilot is named: give --arducopter PROGRAM, --px4 BUILD_FOLDER or --simulated "
            "px4, or set ARDUCOPTER_SITL or PX4_SITL; see docs/how-to/sitl.md"
        )
    return tuple(found)


def _all_scenarios() -> tuple[str, ...]:
    """Return those that come along and need no gimbal, which an autopilot here has not."""
    known = scenario_files().items()
    return tuple(name for name, path in known if load_scenario(path).camera.gimbal is None)


def _environment(name: str) -> Path | None:
    value = os.environ.get(name, "")
    return Path(value) if value else None


def fly_matrix(matrix: SitlMatrix, out: Path) -> int:
    """Fly all of it, write the report after each flight, and return the exit code.

    A flight that could not be flown is a row of the report, except where it is the only one.

    Raises:
        SettingsError: something cannot be used; nothing was flown.
        ConnectionFailedError: the only flight could not be flown.
        ModelError, PluginError: a network or another package's part cannot be used.
    """
    flights = list(matrix.flights())
    for options in flights:
        options.resolve()
    console, rows = Console(), list[dict[str, Any]]()
    folder = new_run_folder(out, "sitl")
    write_whole(folder / RESULTS, "[]\n")
    try:
        for number, options in enumerate(flights, 1):
            title = "" if options.program is None else f" on {options.program.title}"
            print_line(console, f"{number}/{len(flights)} {options.scenario}{title}", "bold")
            rows.append(_fly(replace(options, out=folder), folder, console, len(flights) == 1))
            write_whole(folder / RESULTS, json.dumps(rows, indent=1) + "\n")
            write_whole(folder / REPORT, render(rows))
            if rows[-1]["exit_code"] == INTERRUPTED:
                return INTERRUPTED
    finally:
        if [path.name for path in folder.iterdir()] == [RESULTS]:  # nothing flown, no report
            remove_run_folder(folder)
    print_line(console, str(folder / REPORT))
    if len(rows) == 1:
        return int(rows[0]["exit_code"])
    return SUCCESS if all(row["passed"] for row in rows) else FAILED


def _fly(options: SimulationOptions, folder: Path, console: Console, alone: bool) -> dict[str, Any]:
    row: dict[str, Any] = {
        "scenario": Path(options.scenario).stem,
        "autopilot": options.connect if options.program is None else options.program.title,
        "link": options.link,
        "seed": options.seed,
        "command": options.command,
    }
    try:
        result = simulate(options)
    except (ConnectionFailedError, SettingsError) as error:
        if alone:
            raise
        print_line(console, f"not flown: {error}", "bold red")
        return {**row, "end": f"not flown: {error}", "passed": False, "exit_code": FAILED}
    score = json.loads((result.folder / SCORE).read_text("utf-8"))
    return {
        **row,
        "end": score["run"]["end"],
        "passed": result.exit_code == SUCCESS,
        "failures": score["failures"],
        "violations": result.violations,
        "too_slow": result.too_slow,
        "exit_code": result.exit_code,
        "folder": result.folder.relative_to(folder).as_posix(),
        **{key: score["score"][key] for _, key, _ in _FIGURES},
    }


def render(rows: Sequence[dict[str, Any]]) -> str:
    """Return the report of all flights, a row each."""
    passed = sum(row["passed"] for row in rows)
    headline = f"{passed} of {counted(len(rows), 'flight')} passed"
    lines = [line for row in rows if (line := _failure(row))]
    lines += [f"{_flight(row)}: {why}" for row in rows for why in row.get("too_slow", ())]
    head = ("Scenario", "Autopilot", "Link", "", *(name for name, _, _ in _FIGURES))
    numbers = range(4, 4 + len(_FIGURES))
    commands = html.preformatted("\n".join(row["command"] for row in rows))
    parts = (
        flight_page.verdict_box("passed" if passed == len(rows) else "failed", headline, lines),
        html.section("Flights", html.table(head, map(_cells, rows), tuple(numbers))),
        html.section("To fly them again", commands),
    )
    subtitle = f"software in the loop · {counted(len(rows), 'flight')}"
    meta = ReportMeta("Flights in SITL", subtitle, typed_command())
    return flight_page.filled(meta, parts)


def _failure(row: dict[str, Any]) -> str:
    """Return in a line what a flight missed, "" if nothing."""
    if row["passed"]:
        return ""
    missed = "; ".join((*row.get("violations", ()), *row.get("failures", ()))) or row["end"]
    return f"{_flight(row)}: {missed}"


def _flight(row: dict[str, Any]) -> str:
    return f"{row['scenario']}, {row['autopilot']}{_seed(row)}"


def _seed(row: dict[str, Any]) -> str:
    return "" if row["seed"] is None else f", seed {row['seed']}"


def _cells(row: dict[str, Any]) -> Sequence[Cell]:
    colour, word = ("green", "passed") if row["passed"] else ("red", "failed")
    mark = Html(f'<b style="color: var(--{colour})">{word}</b>')
    figures = ["–" if row.get(key) is None else form.format(row[key]) for _, key, form in _FIGURES]
    name, where = escape(row["scenario"]), row.get("folder")
    linked = name if where is None else f'<a href="{escape(where)}/{REPORT}">{name}</a>'
    return (Html(linked + _seed(row)), row["autopilot"], row["link"], mark, *figures)
