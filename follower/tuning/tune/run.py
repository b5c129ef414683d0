"""`follower tune`: analyse the loops, find gains, print, write."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console

from follower.recording.run_folder import new_run_folder
from follower.settings.settings import (
    Settings,
    configs_folder,
    find_scenario,
    load_settings,
    settings_data,
)
from follower.tuning.identify.result import VEHICLE_FILE, VehicleFile, load_vehicle
from follower.tuning.tune.analysis import (
    AxisAnalysis,
    analyse,
    conditions_of,
    mode_remarks,
    overlay,
    parse_what_ifs,
)
from follower.tuning.tune.report import (
    HEAD,
    WHAT_IF_HEAD,
    rows,
    terminal_table,
    what_if_rows,
    write_tuning,
)
from follower.ui.terminal.console import print_line
from follower_control.common.strict_config import SettingsError, merged
from follower_control.tuning.axes import Axis
from follower_control.tuning.synthesis import TuningGoal
from follower_sim.scenario.scenario_file import base_settings, load_scenario

TUNED_FILE, REPORT = "tuned.yaml", "tuning.html"


@dataclass(frozen=True, slots=True)
class TuneOptions:
    """What the command line was given; see `follower tune --help`."""

    vehicle: str
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    scenario: str | None = None
    bandwidths: tuple[str, ...] = ()
    max_sensitivity: float = 1.6
    what_ifs: tuple[str, ...] = ()
    elevation_deg: float | None = None
    out: Path = Path("runs")
    command: str = "follower tune"

    def goals(self) -> dict[Axis, TuningGoal]:
        """Return the goal of each axis.

        Raises:
            SettingsError: a bandwidth or Ms cannot be used.
        """
        wanted: dict[Axis, float | None] = dict.fromkeys(Axis, None)
        for text in self.bandwidths:
            name, _, value = text.partition("=")
            if name not in list(Axis):
                raise SettingsError(
                    f"--bandwidth {text}: write one of {', '.join(Axis)}, then = and rad/s"
                )
            try:
                wanted[Axis(name)] = float(value)
            except ValueError:
                raise SettingsError(f"--bandwidth {text}: {value!r} is no number") from None
        try:
            return {axis: TuningGoal(wanted[axis], self.max_sensitivity) for axis in Axis}
        except ValueError as error:
            raise SettingsError(f"--bandwidth, --ms: {error}") from None


def tune_follower(options: TuneOptions) -> int:
    """Tune, write the gains and the report; the exit code is 0.

    Raises:
        SettingsError: what the user can mend.
    """
    console = Console()
    scenario = options.scenario
    base = base_settings(load_scenario(find_scenario(scenario))) if scenario else {}
    settings = load_settings(options.config, base, options.overrides)
    vehicle = find_vehicle(options.vehicle)
    conditions = conditions_of(settings, vehicle, elevation_deg(options, settings))
    what_ifs = parse_what_ifs(options.what_ifs, conditions)
    model, goals = vehicle.model(), options.goals()
    with console.status("Tuning"):
        found = analyse(settings, model, conditions, goals, what_ifs)
    data, _ = settings_data(options.config, None, options.overrides)
    said = [f"The vehicle's identification said: {remark}" for remark in vehicle.remarks]
    remarks = [*mode_remarks(settings.servo), *said]
    folder = new_run_folder(options.out, "tune")
    report = write_tuning(folder / REPORT, found, conditions, options.command, remarks)
    path = folder / TUNED_FILE
    path.write_text(tuned_yaml(data, found, options.command), "utf-8")
    load_settings(path)  # what is written can be read
    console.print(terminal_table(HEAD, rows(found)))
    for one in found:
        if one.tuned is not None:
            print_line(console, f"{one.axis}: {one.tuned.because}")
    if what_ifs:
        console.print(terminal_table(WHAT_IF_HEAD, what_if_rows(found)))
    for remark in remarks:
        print_line(console, remark, "yellow")
    for file in (path, report):
        print_line(console, str(file))
    print_line(console, f"Next: follower {_flown(options)} -c {shlex.quote(str(path))}")
    return 0


def _flown(options: TuneOptions) -> str:
    """Return the command that flies by the gains, for the vehicle that they are for."""
    if options.config is not None:
        # Settings of a real vehicle have another lens, and leave taking off to a pilot.
        return "fly ..."
    simulated = f"sim {shlex.quote(options.scenario or 'winding')} --lockstep"
    return f"{simulated} --autopilot ardupilot" if options.vehicle == "ardupilot" else simulated


def tuned_yaml(data: dict[str, object], found: Sequence[AxisAnalysis], command: str) -> str:
    """Return the user's own settings with the new gains in them, for `-c` of fly and sim."""
    lines = "".join(f"#   {line}\n" for line in table_lines(found))
    text = yaml.safe_dump(merged(data, overlay(found)), sort_keys=False, allow_unicode=True)
    return f"# Gains by: {' '.join(command.split())}\n{lines}{text}"


def table_lines(found: Sequence[AxisAnalysis]) -> list[str]:
    """Return the gains before and after, a line an axis."""
    return [
        f"{one.axis}: kp {one.gains.kp:.3g} -> {one.chosen.kp:.3g}, ki {one.gains.ki:.3g} -> "
        f"{one.chosen.ki:.3g}, kd {one.gains.kd:.3g} -> {one.chosen.kd:.3g}"
        for one in found
    ]


def find_vehicle(text: str) -> VehicleFile:
    """Return the file of a vehicle, or that of one of the vehicles that come along.

    Raises:
        SettingsError: there is neither.
    """
    path = Path(text)
    if (path / VEHICLE_FILE).is_file():
        path /= VEHICLE_FILE
    if path.suffix in (".yaml", ".yml"):
        return load_vehicle(path)
    known = {one.stem: one for one in sorted((configs_folder() / "vehicles").glob("*.yaml"))}
    if text not in known:
        raise SettingsError(
            f"there is no vehicle {text!r}: give the vehicle.yaml of `follower identify`, or one "
            f"of {', '.join(known)}"
        )
    return load_vehicle(known[text])


def elevation_deg(options: TuneOptions, settings: Settings) -> float:
    """Return the elevation, degrees, of the analysed loops: as given, wanted, or mounted."""
    if options.elevation_deg is not None:
        if not abs(options.elevation_deg) < 85:
            raise SettingsError("--elevation lies within ±85 degrees")
        return options.elevation_deg
    wanted = settings.servo.elevation_deg
    elevation = settings.camera.pitch_deg if wanted is None else wanted
    return max(-80.0, min(80.0, elevation))
