"""`follower sim` and `follower demo`: fly a scenario and report on it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
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
from follower.flight_extras import FlightExtras
from follower.flight_video import BackgroundVideo, OverlayVideo, SeveralVideos
from follower.fly.keyboard import Keyboard
from follower.flying import fly_lockstep, fly_realtime
from follower.ground_station.opening import open_ground_station, operators_finder
from follower.interrupt import StopOnInterrupt
from follower.keeping_up import said_of_late_frames
from follower.links.connection import ConnectionFailedError, open_connection
from follower.links.link_settings import LINK_KINDS
from follower.print_line import print_line
from follower.recorder import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder, epoch_now_ns
from follower.run_folder import new_run_folder, remove_run_folder
from follower.scenario_start import base_settings
from follower.settings import Settings, load_settings
from follower.sight import Sight, check_without_pixels
from follower.simulated_flight import EXTERNAL, SimulatedFlight
from follower.simulation_options import SimulationOptions
from follower.simulation_report import NO_PIXELS, VIDEO, report_flight
from follower.station.station import Station
from follower.terminal import Terminal
from follower_control.strict_yaml import SettingsError
from follower_control.transport import MemoryTransport, Transport
from follower_sim.scenario import Scenario
from follower_sim.scenario_file import load_scenario
from follower_sim.world import World
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock

_SUCCESS, _FAILED, _INTERRUPTED = 0, 1, 130
FLAVOURS = ("px4", "ardupilot", EXTERNAL)
INTERRUPTED = "The user ended this flight."


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
                order = _Order(world, settings, options, planned, folder, console)
                flown = _fly(order, ends, early)
            except ConnectionFailedError:
                remove_run_folder(folder)  # there was no flight
                raise
            met = report_flight(flown.flight, options, folder, flown.remarks, console)
    if INTERRUPTED in flown.remarks:
        return _INTERRUPTED
    passed = all(one.passed for one in flown.judged) if flown.judged else met
    return _SUCCESS if passed else _FAILED


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


@dataclass(frozen=True, slots=True)
class _Order:
    """What is to be flown, and where its results go."""

    world: World
    settings: Settings
    options: SimulationOptions
    planned: tuple[PlannedFault, ...]
    folder: Path
    console: Console


@dataclass(frozen=True, slots=True)
class _Flown:
    """A flight that is over, what its reader must know, and what came of its faults."""

    flight: SimulatedFlight
    remarks: tuple[str, ...]
    judged: list[Verdict]


def _fly(order: _Order, ends: tuple[Transport, Transport], early: StopOnInterrupt) -> _Flown:
    options, world = order.options, order.world
    clock = SimulatedClock() if options.lockstep else MonotonicClock()
    with (
        as_faults_want(order.planned, order.settings, ends, clock) as (settings, ends),
        _injector(order, clock) as injector,
        _video(order) as video,
        _recorder(order, settings, clock) as recorder,
        _station(order, settings) as station,
    ):
        videos = [one for one in (video, station) if one is not None]
        extras = FlightExtras(
            video=SeveralVideos(videos) if videos else None,
            recorder=recorder,
            parts=injector,
            sight=options.sight,
            finder=operators_finder(settings, options.cockpit),
        )
        flight = SimulatedFlight(world, settings, options.autopilot, clock, ends, extras)
        interrupted = _fly_to_its_end(flight, order, station, clock, early)
    judged = [] if injector is None else verdicts(order.planned, flight, injector)
    remarks = (
        NO_PIXELS if options.sight is Sight.TRUTH else None,
        INTERRUPTED if interrupted else None,
        _said_of_late_frames(flight, options),
        video.remark if video else None,
        station.remark if station else None,
    )
    recorded = () if recorder is None else recorder.remarks
    said = (*(remark for remark in remarks if remark is not None), *recorded)
    return _Flown(flight, (*said, *map(said_of, judged)), judged)


def _said_of_late_frames(flight: SimulatedFlight, options: SimulationOptions) -> str | None:
    silent = options.faults or any(one.kind == "silent" for one in flight.scenario.faults)
    if options.lockstep or silent or options.sight is Sight.TRUTH:
        return None
    return said_of_late_frames(flight.log, flight.scenario.camera.rate_hz)


def _fly_to_its_end(
    flight: SimulatedFlight,
    order: _Order,
    station: Station | None,
    clock: SimulatedClock | MonotonicClock,
    early: StopOnInterrupt,
) -> bool:
    """Fly before the user's eyes, and return whether they ended it."""
    cockpit = order.options.cockpit
    if cockpit:
        flight.operate()
    page = None if station is None else FlightShow(station, flight)
    terminal = Terminal(order.console, order.world.scenario.title)
    ground = _ground_station(flight, order.options, clock)
    with closing(flight), ground, terminal, StopOnInterrupt(flight.stop) as interrupt:
        if early.interrupted:
            flight.stop()
        keyboard = Keyboard(sys.stdin)

        def show() -> None:
            status = flight.status()
            terminal.show(status)
            if page is not None:
                page.show(status)
            if flight.settings.consent.kind == "terminal":
                flight.stage.order(keyboard.order())

        with suppress(InjectedDeathError):
            if isinstance(clock, SimulatedClock):
                fly_lockstep(flight, clock, show, paced=cockpit)
            else:
                fly_realtime(flight, clock, show)
    return interrupt.interrupted or early.interrupted


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
def _injector(order: _Order, clock: Clock) -> Iterator[FaultInjector | None]:
    if not order.planned:
        yield None
        return
    with FaultInjector(order.planned, clock, order.options.autopilot, order.world.seed) as injector:
        yield injector


@contextmanager
def _video(order: _Order) -> Iterator[OverlayVideo | BackgroundVideo | None]:
    if not order.options.video:
        yield None
        return
    kind = OverlayVideo if order.options.lockstep else BackgroundVideo
    with kind(order.folder / VIDEO, order.world.scenario.camera.rate_hz) as video:
        yield video


@contextmanager
def _station(order: _Order, settings: Settings) -> Iterator[Station | None]:
    """Give what shows the flight to others, None if nobody wants to see it."""

    def say(text: str) -> None:
        print_line(order.console, text)

    options = order.options
    recording = order.folder.name if options.recorded else ""
    page = first_page("sim", order.world.scenario.title, settings, recording)
    station = open_station(settings, options.cockpit, page, options.out, say)
    with station or nullcontext():
        yield station


@contextmanager
def _recorder(order: _Order, settings: Settings, clock: Clock) -> Iterator[Recorder | None]:
    options, world = order.options, order.world
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
            "detection": "inline" if options.lockstep else "background",
            "command": options.command,
        },
        camera=world.scenario.camera.model,
        epoch_ns=LOCKSTEP_EPOCH_NS if options.lockstep else epoch_now_ns(clock),
    )
    threaded = not options.lockstep
    recorder = Recorder(order.folder, config, clock, settings.recorder, threaded=threaded)
    with recorder:
        yield recorder
