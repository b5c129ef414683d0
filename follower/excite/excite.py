"""`follower excite`: fly the pattern, and say what to do with the recording."""

from __future__ import annotations

import shlex
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from follower.excite.flight import ExcitationFlight, OnStep, camera_of, fly_simulated, run_of
from follower.excite.pattern import ExcitationSettings, Pattern
from follower.excite.stage import excitation_settings
from follower.interrupt import StopOnInterrupt
from follower.links.connection import open_connection
from follower.links.opening import open_link
from follower.print_line import print_line
from follower.recorder import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder, epoch_now_ns
from follower.run_folder import new_run_folder
from follower.settings import Settings, load_settings
from follower_control.strict_yaml import SettingsError
from follower_sim.scenario import WindSettings
from follower_sim.wind import Wind
from follower_vision.clock import MonotonicClock, SimulatedClock

_SUCCESS, _INCOMPLETE = 0, 1
FLAVOURS = ("px4", "ardupilot")


@dataclass(frozen=True, slots=True)
class ExciteOptions:
    """What the command line was given; see `follower excite --help`."""

    excitation: ExcitationSettings
    connect: str | None = None
    autopilot: str = "px4"
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    out: Path = Path("runs")
    wind_m_s: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.autopilot not in FLAVOURS:
            raise SettingsError(f"--autopilot {self.autopilot}: choose {' or '.join(FLAVOURS)}")
        if not 0 <= self.wind_m_s <= 20:
            raise SettingsError(f"--wind lies within 0 and 20 m/s, not {self.wind_m_s:g}")
        if self.seed < 0:
            raise SettingsError(f"--seed is not negative, not {self.seed}")

    @property
    def command(self) -> str:
        """The command line that does this again."""
        e = self.excitation
        words = ["follower", "excite", "--pattern", e.kind.value]
        words += ["--connect", self.connect] if self.connect else ["--autopilot", self.autopilot]
        for name, value in (
            ("forward", e.forward_m_s),
            ("right", e.right_m_s),
            ("vertical", e.vertical_m_s),
            ("yaw", e.yaw_deg_s),
            ("wind", self.wind_m_s),
            ("seed", self.seed),
        ):
            words += [f"--{name}", f"{value:g}"]
        words += [] if self.config is None else ["--config", str(self.config)]
        for one in self.overrides:
            words += ["--set", one]
        return shlex.join(words)


def excite(options: ExciteOptions) -> int:
    """Fly the pattern; return 0 if all of it was flown, 1 if somebody or something ended it.

    Raises:
        SettingsError, ConnectionFailedError: what the user can mend, in one line.
    """
    base = {"autonomy": "pilot" if options.connect else "full"}
    settings = load_settings(options.config, base, options.overrides)
    settings = excitation_settings(settings)
    console = Console()
    length_s = Pattern(options.excitation).length_s
    words = TextColumn("{task.description}", markup=False)
    with Progress(words, BarColumn(), TimeRemainingColumn(), console=console) as progress:
        task = progress.add_task("Waiting for the vehicle", total=length_s)

        def watch(flight: ExcitationFlight) -> None:
            supervisor = flight.stage.supervisor
            said = f"{supervisor.state}: {supervisor.reason}"
            progress.update(task, completed=flight.stage.elapsed_s, description=said)

        if options.connect is None:
            folder, flight = _simulated(options, settings, watch)
        else:
            folder, flight = _real(options, settings, options.connect, watch)
    return _told(console, folder, flight)


def _told(console: Console, folder: Path, flight: ExcitationFlight) -> int:
    if flight.complete:
        print_line(console, f"All of the pattern was flown: {folder}")
    else:
        reason = flight.stage.supervisor.reason
        print_line(
            console,
            f"Ended early ({reason}) after {flight.stage.elapsed_s:.0f} of "
            f"{flight.pattern.length_s:.0f} s: {folder}",
        )
    print_line(console, f"Next: follower identify {shlex.quote(str(folder))}")
    return _SUCCESS if flight.complete else _INCOMPLETE


def _config(options: ExciteOptions, settings: Settings, kind: str, epoch_ns: int) -> FlightConfig:
    run = {
        **run_of(options.excitation),
        "autopilot": options.connect or options.autopilot,
        "seed": options.seed,
        "command": options.command,
    }
    camera = camera_of(settings)
    return FlightConfig.of(kind, settings, run=run, camera=camera, epoch_ns=epoch_ns)


def _simulated(
    options: ExciteOptions, settings: Settings, watch: OnStep
) -> tuple[Path, ExcitationFlight]:
    clock = SimulatedClock()
    folder = new_run_folder(options.out, "excite")
    config = _config(options, settings, "simulated", LOCKSTEP_EPOCH_NS)
    gusts = WindSettings(mean_m_s=options.wind_m_s, from_deg=40.0, gust_m_s=0.2 * options.wind_m_s)
    wind = Wind(gusts, np.random.default_rng(options.seed)).velocity_m_s
    with Recorder(folder, config, clock, settings.recorder, threaded=False) as recorder:
        flight = fly_simulated(
            options.autopilot,
            settings,
            options.excitation,
            recorder,
            clock,
            watch,
            wind if options.wind_m_s else None,
        )
    return folder, flight


def _real(
    options: ExciteOptions, settings: Settings, connect: str, watch: OnStep
) -> tuple[Path, ExcitationFlight]:
    clock = MonotonicClock()
    epoch_ns = epoch_now_ns(clock)
    with ExitStack() as stack:
        transport = open_connection(connect)
        stack.callback(transport.close)
        folder = new_run_folder(options.out, "excite")
        config = _config(options, settings, "real", epoch_ns)
        recorder = stack.enter_context(Recorder(folder, config, clock, settings.recorder))
        wrapped = recorder.transport(transport)
        link = stack.enter_context(closing(open_link(wrapped, settings.link, clock, epoch_ns)))
        flight = ExcitationFlight(settings, options.excitation, link, clock, recorder.log)
        stack.enter_context(StopOnInterrupt(flight.stage.request_stop))
        flight.run(watch)
    return folder, flight
