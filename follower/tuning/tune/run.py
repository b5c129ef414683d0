"""`follower tune`: look at the loops, find gains, tell, write."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from rich.console import Console
from rich.progress import track
from rich.table import Table

from follower.configs import configs_folder, find_scenario
from follower.identify.result import VehicleFile, load_vehicle
from follower.print_line import print_line
from follower.run_folder import new_run_folder
from follower.scenario_start import base_settings
from follower.settings import Settings, load_settings, merged, settings_data
from follower.tune.analysis import AxisAnalysis, analyse, conditions_of, overlay
from follower.tune.what_if import parse_what_ifs
from follower_control.strict_yaml import SettingsError
from follower_control.tuning.axes import Axis
from follower_control.tuning.axis_loop import AxisLoop
from follower_control.tuning.synthesis import Wish
from follower_sim.scenario_file import load_scenario

TUNED_FILE, REPORT = "tuned.yaml", "tuning.html"
_USUAL_ELEVATION_DEG = -20.0


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

    @property
    def command(self) -> str:
        """The command line that does this again."""
        words = ["follower", "tune", self.vehicle, "--ms", f"{self.max_sensitivity:g}"]
        words += [] if self.config is None else ["--config", str(self.config)]
        words += [] if self.scenario is None else ["--scenario", self.scenario]
        for name, values in (
            ("bandwidth", self.bandwidths),
            ("what-if", self.what_ifs),
            ("set", self.overrides),
        ):
            for value in values:
                words += [f"--{name}", value]
        words += [] if self.elevation_deg is None else ["--elevation", f"{self.elevation_deg:g}"]
        return shlex.join(words)

    def wishes(self) -> dict[Axis, Wish]:
        """Return what each axis is to be like.

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
            return {axis: Wish(wanted[axis], self.max_sensitivity) for axis in Axis}
        except ValueError as error:
            raise SettingsError(f"--bandwidth, --ms: {error}") from None


def tune_follower(options: TuneOptions) -> int:
    """Tune, write the gains and the report; the exit code is 0.

    Raises:
        SettingsError: what the user can mend.
    """
    console = Console()
    base = {}
    if options.scenario is not None:
        base = base_settings(load_scenario(find_scenario(options.scenario)))
    settings = load_settings(options.config, base, options.overrides)
    vehicle = find_vehicle(options.vehicle)
    conditions = conditions_of(settings, vehicle, elevation_deg(options, settings))
    what_ifs = parse_what_ifs(options.what_ifs, conditions)

    def show(axes: Sequence[Axis]) -> Sequence[Axis]:
        return list(track(axes, "Tuning", console=console, transient=True))

    model, wishes = vehicle.model(), options.wishes()
    found = analyse(settings, model, conditions, wishes, what_ifs, show)
    data, _ = settings_data(options.config, None, options.overrides)
    folder = new_run_folder(options.out, "tune")
    from follower.report.tuning import write_tuning

    report = write_tuning(folder / REPORT, found, conditions, options.command, vehicle.remarks)
    path = folder / TUNED_FILE
    path.write_text(tuned_yaml(data, found, options.command), "utf-8")
    load_settings(path)  # what is written can be read
    console.print(before_after(found))
    for one in found:
        if one.tuned is not None:
            print_line(console, f"{one.axis}: {one.tuned.because}")
    if what_ifs:
        console.print(what_if_table(found))
    for remark in vehicle.remarks:
        print_line(console, f"The vehicle's identification said: {remark}", "yellow")
    for file in (path, report):
        print_line(console, str(file))
    # Settings of a real vehicle have another lens, and leave taking off to a pilot.
    flown = f"sim {shlex.quote(options.scenario or 'winding')} --lockstep"
    program = flown if options.config is None else "fly ..."
    print_line(console, f"Next: follower {program} -c {shlex.quote(str(path))}")
    return 0


def tuned_yaml(data: dict[str, object], found: Sequence[AxisAnalysis], command: str) -> str:
    """Return the user's own settings with the new gains in them, for `-c` of fly and sim."""
    lines = "".join(f"#   {line}\n" for line in table_lines(found))
    text = yaml.safe_dump(merged(data, overlay(found)), sort_keys=False, allow_unicode=True)
    return f"# Gains by: {command}\n{lines}{text}"


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
    if path.is_dir():
        path /= "vehicle.yaml"
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
    """Return at which elevation the loops are looked at: as given, as wanted, or as mounted."""
    if options.elevation_deg is not None:
        if not abs(options.elevation_deg) < 85:
            raise SettingsError("--elevation lies within ±85 degrees")
        return options.elevation_deg
    wanted = settings.servo.elevation_deg
    mounted = settings.camera.pitch_deg or _USUAL_ELEVATION_DEG
    elevation = mounted if wanted is None else wanted
    return max(-80.0, min(80.0, elevation))


HEAD = ("Loop", "Gains", "kp", "ki", "kd", "Bandwidth", "Ms", "Gain m.", "Phase m.", "Delay m.")


def before_after(found: Sequence[AxisAnalysis]) -> Table:
    """Return the table of now and after."""
    return _table(HEAD, rows(found))


def rows(found: Sequence[AxisAnalysis]) -> list[tuple[str, ...]]:
    """Return the table's rows: each axis now and, if it was tuned, after."""
    made = []
    for one in found:
        g = one.gains
        made.append((one.axis.value, "now", *_gains(g.kp, g.ki, g.kd), *worth(one.now)))
        if one.tuned is not None:
            g = one.tuned.gains
            made.append(("", "after", *_gains(g.kp, g.ki, g.kd), *worth(one.tuned.loop)))
    return made


def what_if_table(found: Sequence[AxisAnalysis]) -> Table:
    """Return what the chosen gains survive."""
    return _table(("Loop", "What if", *HEAD[5:]), what_if_rows(found))


def _table(head: Sequence[str], body: Sequence[Sequence[str]]) -> Table:
    """Return a table of which nothing is cut on a terminal of 80 columns."""
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="dim")
    for name in head:
        table.add_column(name, overflow="fold", no_wrap=name != "What if")
    for row in body:
        table.add_row(*row)
    return table


def what_if_rows(found: Sequence[AxisAnalysis]) -> list[tuple[str, ...]]:
    """Return its rows."""
    return [(one.axis.value, words, *worth(loop)) for one in found for words, loop in one.what_ifs]


def _gains(kp: float, ki: float, kd: float) -> tuple[str, str, str]:
    return f"{kp:.3g}", f"{ki:.3g}", f"{kd:.3g}"


def worth(loop: AxisLoop) -> tuple[str, ...]:
    """Return bandwidth, Ms and the three margins, as text; an unstable loop has none."""
    if not loop.is_stable():
        return ("unstable", "–", "–", "–", "–")
    m = loop.margins()
    gain = "∞" if math.isinf(m.gain) else f"×{m.gain:.1f}"
    phase = "∞" if math.isinf(m.phase_rad) else f"{math.degrees(m.phase_rad):.0f}°"
    delay = "∞" if math.isinf(m.delay_s) else f"{m.delay_s:.2f} s"
    return f"{loop.bandwidth_rad_s():.2f} rad/s", f"{m.max_sensitivity:.2f}", gain, phase, delay
