"""`follower sim` and `follower demo`: fly a scenario and report on it."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import cv2
from rich.console import Console

from follower.cockpit.opening import open_station
from follower.cockpit.showing import FlightShow, first_page
from follower.configs import find_scenario
from follower.faults.injector import FaultInjector
from follower.faults.planned import PlannedFault
from follower.faults.simulation import as_faults_want, said_of, verdicts
from follower.faults.stages import InjectedDeathError
from follower.faults.verdict import Verdict
from follower.flight_video import BackgroundVideo, OverlayVideo, SeveralVideos
from follower.fly.keyboard import Keyboard
from follower.flying import fly_lockstep, fly_realtime
from follower.ground_station.opening import open_ground_station, operators_finder
from follower.interrupt import StopOnInterrupt
from follower.links.connection import ConnectionFailedError, open_connection
from follower.links.link_settings import LINK_KINDS
from follower.outputs import write_boxes, write_setpoints
from follower.recorder import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder, epoch_now_ns
from follower.report.meta import ReportMeta
from follower.report.writer import write_report, write_score, write_whole
from follower.run_folder import new_run_folder, remove_run_folder
from follower.scoring import score_flight
from follower.settings import Settings, load_settings
from follower.sight import Sight, check_without_pixels
from follower.simulated_flight import EXTERNAL, SimulatedFlight, base_settings
from follower.station.station import Station
from follower.terminal import Terminal, print_score
from follower_control.strict_yaml import SettingsError
from follower_control.transport import MemoryTransport, Transport
from follower_sim.criteria import verdict
from follower_sim.scenario import Scenario
from follower_sim.scenario_file import SCENE, load_scenario
from follower_sim.stand_in import LABEL
from follower_sim.world import World
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock

_SUCCESS, _FAILED, _INTERRUPTED = 0, 1, 130
FLAVOURS = ("px4", "ardupilot", EXTERNAL)
INTERRUPTED = "The user ended this flight."
NO_PIXELS = LABEL[0].upper() + LABEL[1:]
VIDEO = "overlay.mp4"
FILES = (
    ("report.html", "this report"),
    (VIDEO, "to watch: what the camera saw, with the track drawn into it"),
    ("flight.mcap", "the recording: every message, for `follower replay`, Foxglove, PlotJuggler"),
    ("mavlink.tlog", "the recording: every MAVLink packet, for Mission Planner and MAVProxy"),
    ("video.mkv", "the recording: the frames that vision saw, nothing drawn into them"),
    ("config.yaml", "the recording: settings, versions, hashes of networks, seed"),
    ("score.json", "the score and its limits"),
    ("boxes.csv", "the track, a line a frame"),
    ("setpoints.csv", "the setpoints, a line a control step"),
    ("settings.yaml", "the settings as resolved"),
)


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """What the command line was given; see `follower sim --help`."""

    scenario: str
    autopilot: str = "px4"
    seed: int | None = None
    lockstep: bool = False
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    out: Path = Path("runs")
    video: bool = True
    connect: str = "udpin:127.0.0.1:14540"
    record: bool = True
    link: str | None = None
    faults: tuple[str, ...] = ()
    sight: Sight = Sight.PIXELS
    scene: tuple[str, ...] = ()
    cockpit: bool = False

    @property
    def recorded(self) -> bool:
        """Whether it is recorded; a replay could see nothing in a recording without pixels."""
        return self.record and self.sight is Sight.PIXELS

    @property
    def command(self) -> str:
        """The command line that does this run again."""
        words = ["follower", "sim", self.scenario, "--autopilot", self.autopilot]
        words += [] if self.lockstep else ["--connect", self.connect]
        words += [] if self.link is None else ["--link", self.link]
        words += [] if self.seed is None else ["--seed", str(self.seed)]
        words += ["--lockstep"] if self.lockstep else []
        words += ["--cockpit"] if self.cockpit else []
        words += [] if self.config is None else ["--config", str(self.config)]
        for override in self.overrides:
            words += ["--set", override]
        for override in self.scene:
            words += [SCENE, override]
        words += [] if self.sight is Sight.PIXELS else ["--vision", self.sight]
        for fault in self.faults:
            words += ["--fault", fault]
        return shlex.join(words)


def simulate(options: SimulationOptions) -> int:
    """Fly, write the report, and return the exit code."""
    if options.autopilot not in FLAVOURS:
        raise SettingsError(f"--autopilot {options.autopilot}: choose {' or '.join(FLAVOURS)}")
    if options.lockstep and options.autopilot == EXTERNAL:
        raise SettingsError("--lockstep needs a simulated autopilot: px4 or ardupilot")
    if options.faults and options.autopilot == EXTERNAL:
        raise SettingsError("--fault needs a simulated autopilot: px4 or ardupilot")
    planned = tuple(PlannedFault.parse(text) for text in options.faults)
    scenario = load_scenario(find_scenario(options.scenario), options.scene)
    if options.sight is Sight.TRUTH:
        check_without_pixels(scenario, options.faults)
    settings = simulation_settings(scenario, options)
    if options.lockstep and settings.link.kind == "mavsdk":
        raise SettingsError("--lockstep: mavsdk has its own threads and time; use --link pymavlink")
    console = Console()
    # Autopilot, camera, vision and control share few cores: OpenCV's own threads would take them.
    cv2.setNumThreads(1)
    with _transports(options) as ends:
        with console.status("Building the world"):
            world = World(scenario, options.seed)
            if options.sight is Sight.PIXELS or options.video:
                _build(world)
        # A flight has its own way to end; whatever is written after it is to be whole.
        with StopOnInterrupt() as early:
            folder = new_run_folder(options.out, scenario.name)
            try:
                flight, remarks, judged = _fly(
                    world, settings, options, ends, folder, console, planned, early
                )
            except ConnectionFailedError:
                remove_run_folder(folder)  # there was no flight
                raise
            return _report(flight, options, folder, remarks, console, judged)


def simulation_settings(scenario: Scenario, options: SimulationOptions) -> Settings:
    """Resolve the settings: the scenario's camera and wishes first, the user's on top."""
    base = base_settings(scenario)
    if options.link is not None and options.link not in LINK_KINDS:
        raise SettingsError(f"--link {options.link}: choose {' or '.join(LINK_KINDS)}")
    link = () if options.link is None else (f"link.kind={options.link}",)
    return load_settings(options.config, base, (*options.overrides, *link))


def _build(world: World) -> None:
    """Paint what takes seconds before the clock starts to run."""
    _ = world.ground, world.sky, world.scenery_batch


@contextmanager
def _transports(options: SimulationOptions) -> Iterator[tuple[Transport, Transport]]:
    """Give the follower's end and the autopilot's: memory in lockstep, else real sockets."""
    if options.lockstep:
        yield MemoryTransport.pair()
        return
    with closing(open_connection(options.connect)) as ours:
        if options.autopilot == EXTERNAL:
            yield ours, MemoryTransport.pair()[1]
            return
        with closing(open_connection(other_end(options.connect))) as theirs:
            yield ours, theirs


def other_end(connection: str) -> str:
    """Return the connection that a simulated autopilot has to open for this one of ours."""
    kind, _, address = connection.partition(":")
    address = address.replace("0.0.0.0", "127.0.0.1")  # noqa: S104  read, not bound
    others = {"udpin": "udpout", "udp": "udpout", "udpout": "udpin", "tcpin": "tcp"}
    if kind not in others:
        raise ConnectionFailedError(
            f"{connection}: a simulated autopilot is reached by udpin:, udpout: or tcpin:; "
            "use --autopilot external for one that runs elsewhere"
        )
    return f"{others[kind]}:{address}"


def _fly(
    world: World,
    settings: Settings,
    options: SimulationOptions,
    ends: tuple[Transport, Transport],
    folder: Path,
    console: Console,
    planned: tuple[PlannedFault, ...],
    early: StopOnInterrupt,
) -> tuple[SimulatedFlight, tuple[str, ...], list[Verdict]]:
    """Return the flight when it is over, what its reader must know, what came of its faults."""
    clock = SimulatedClock() if options.lockstep else MonotonicClock()
    with (
        as_faults_want(planned, settings, ends, clock) as (settings, ends),
        _injector(planned, clock, options, world.seed) as injector,
        _video(options, folder, world.scenario.camera.rate_hz) as video,
        _recorder(options, world, settings, clock, folder) as recorder,
        _station(options, world, settings, folder, console) as station,
    ):
        videos = [one for one in (video, station) if one is not None]
        flight = SimulatedFlight(
            world,
            settings,
            options.autopilot,
            clock,
            ends,
            SeveralVideos(videos) if videos else None,
            recorder,
            injector,
            sight=options.sight,
            finder=operators_finder(settings, options.cockpit),
        )
        if options.cockpit:
            flight.operate()
        page = None if station is None else FlightShow(station, flight)
        terminal = Terminal(console, world.scenario.title)
        ground = _ground_station(flight, options, clock)
        with closing(flight), ground, terminal, StopOnInterrupt(flight.stop) as interrupt:
            if early.interrupted:
                flight.stop()
            keyboard = Keyboard(sys.stdin)

            def show() -> None:
                status = flight.status()
                terminal.show(status)
                if page is not None:
                    page.show(status)
                if settings.consent.kind == "terminal":
                    flight.stage.order(keyboard.order())

            with suppress(InjectedDeathError):
                if isinstance(clock, SimulatedClock):
                    fly_lockstep(flight, clock, show, paced=options.cockpit)
                else:
                    fly_realtime(flight, clock, show)
    judged = [] if injector is None else verdicts(planned, flight, injector)
    interrupted = interrupt.interrupted or early.interrupted
    remarks = (
        NO_PIXELS if options.sight is Sight.TRUTH else None,
        INTERRUPTED if interrupted else None,
        video.remark if video else None,
        station.remark if station else None,
    )
    recorded = () if recorder is None else recorder.remarks
    said = (*(remark for remark in remarks if remark is not None), *recorded)
    return flight, (*said, *map(said_of, judged)), judged


def _ground_station(
    flight: SimulatedFlight, options: SimulationOptions, clock: Clock
) -> AbstractContextManager[None]:
    """Answer ground stations in real time; a simulated clock has no time for them."""
    if isinstance(clock, SimulatedClock):
        return nullcontext()
    save = partial(flight.requests.save, options.config)
    rate_hz = flight.scenario.camera.rate_hz
    return open_ground_station(flight.settings, flight.view, rate_hz, clock, save)


@contextmanager
def _injector(
    planned: tuple[PlannedFault, ...], clock: Clock, options: SimulationOptions, seed: int
) -> Iterator[FaultInjector | None]:
    if not planned:
        yield None
        return
    with FaultInjector(planned, clock, options.autopilot, seed) as injector:
        yield injector


@contextmanager
def _video(
    options: SimulationOptions, folder: Path, rate_hz: float
) -> Iterator[OverlayVideo | BackgroundVideo | None]:
    if not options.video:
        yield None
        return
    kind = OverlayVideo if options.lockstep else BackgroundVideo
    with kind(folder / VIDEO, rate_hz) as video:
        yield video


@contextmanager
def _station(
    options: SimulationOptions, world: World, settings: Settings, folder: Path, console: Console
) -> Iterator[Station | None]:
    """Give what shows the flight to others, None if nobody wants to see it."""

    def say(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    recording = folder.name if options.recorded else ""
    page = first_page("sim", world.scenario.title, settings, recording)
    station = open_station(settings, options.cockpit, page, options.out, say)
    with station or nullcontext():
        yield station


@contextmanager
def _recorder(
    options: SimulationOptions, world: World, settings: Settings, clock: Clock, folder: Path
) -> Iterator[Recorder | None]:
    if not options.recorded:
        yield None
        return
    config = FlightConfig.of(
        "simulated",
        settings,
        run={
            "scenario": world.scenario.name,
            "title": world.scenario.title,
            "autopilot": options.autopilot,
            "seed": world.seed,
            "lockstep": options.lockstep,
            "command": options.command,
        },
        camera=world.scenario.camera.model,
        epoch_ns=LOCKSTEP_EPOCH_NS if options.lockstep else epoch_now_ns(clock),
    )
    recorder = Recorder(folder, config, clock, settings.recorder, threaded=not options.lockstep)
    with recorder:
        yield recorder


def _report(
    flight: SimulatedFlight,
    options: SimulationOptions,
    folder: Path,
    remarks: tuple[str, ...],
    console: Console,
    judged: list[Verdict],
) -> int:
    """Write everything, say what came of it, and return the exit code."""
    criteria = flight.scenario.expect
    score = score_flight(
        flight.log,
        flight.truth,
        flight.goal,
        overlaps=flight.overlaps,
        identity=flight.identity,
        chosen_s=flight.chosen_s,
    )
    write_boxes(folder / "boxes.csv", flight.log.tracks)
    write_setpoints(folder / "setpoints.csv", flight.log.controls)
    write_whole(folder / "settings.yaml", flight.settings.to_yaml())
    run = {
        "scenario": flight.scenario.name,
        "autopilot": options.autopilot,
        "seed": flight.seed,
        "vision": str(options.sight),
    }
    write_score(folder, score, criteria, run)
    write_report(
        folder,
        flight.log,
        _meta(flight, options, remarks),
        truth=flight.truth,
        goal=flight.goal,
        score=score,
        criteria=criteria,
        target_size_m=flight.settings.servo.target_size_m,
    )
    files = [folder / name for name, _ in FILES if (folder / name).exists()]
    print_score(console, score, criteria, files)
    for remark in remarks:
        console.print(remark, highlight=False)
    if INTERRUPTED in remarks:
        return _INTERRUPTED
    if judged:
        return _SUCCESS if all(one.passed for one in judged) else _FAILED
    return _FAILED if verdict(score, criteria) else _SUCCESS


def _meta(
    flight: SimulatedFlight, options: SimulationOptions, remarks: tuple[str, ...]
) -> ReportMeta:
    how = "lockstep" if options.lockstep else "real time"
    how += f" · {LABEL}" if options.sight is Sight.TRUTH else ""
    kind = flight.settings.link.kind
    link = "through memory" if options.lockstep else f"by {kind}, {options.connect}"
    return ReportMeta(
        title=flight.scenario.title,
        subtitle=f"{flight.scenario.name} · {options.autopilot} · seed {flight.seed} · {how}",
        command=options.command,
        settings_yaml=flight.settings.to_yaml(),
        facts=(
            ("Version", version("drone-target-follower")),
            ("Python", sys.version.split()[0]),
            ("Autopilot", options.autopilot),
            ("Link", f"MAVLink 2 {link}"),
            ("Link at the end", flight.link_status.line()),
            ("Vision", NO_PIXELS if options.sight is Sight.TRUTH else flight.settings.tracker),
            ("Seed", str(flight.seed)),
        ),
        files=FILES,
        video=VIDEO if options.video else "",
        remarks=remarks,
    )
