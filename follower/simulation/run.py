"""`follower sim` and `follower demo`: fly a scenario and report on it."""

import sys
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from follower.flight.log import FlightLog, noting_failed_plugins
from follower.flight.supervision.flight_end import (
    BY_CTRL_C,
    FAILED,
    NOT_RECORDED,
    SUCCESS,
    FlightEnd,
)
from follower.flight.vision.video_sink import BackgroundVideo, OverlayVideo, SeveralVideos
from follower.links.connections import ConnectionFailedError
from follower.recording import FlightConfig, Recorder
from follower.recording.config import INLINE, late_detection
from follower.recording.run_folder import new_run_folder, remove_run_folder
from follower.settings.settings import Settings
from follower.simulation.autopilot_connection import AutopilotConnection
from follower.simulation.components import FlightOptions
from follower.simulation.faults.fault import PlannedFault
from follower.simulation.faults.in_simulation import as_faults_want, describe_verdict, verdicts
from follower.simulation.faults.injector import FaultInjector, InjectedDeathError
from follower.simulation.flight import SimulatedFlight, epoch_ns
from follower.simulation.options import SimulationOptions, VisionSource
from follower.simulation.report import NO_PIXELS, VIDEO, report_flight
from follower.simulation.runners import fly_lockstep, fly_realtime
from follower.simulation.sitl_session import SitlSession
from follower.ui.cockpit.publisher import FlightPublisher, initial_state
from follower.ui.cockpit.start import open_station
from follower.ui.ground_station.server import open_ground_station, operators_finder
from follower.ui.ipc.server_client import UiProcessClient
from follower.ui.terminal.console import lasting_console, print_line
from follower.ui.terminal.flight_display import FlightDisplay
from follower.ui.terminal.interrupt import Keyboard, StopOnInterrupt
from follower_control.common.transport import Transport
from follower_sim.scoring.score import PursuitScore
from follower_sim.world.world import World
from follower_vision.clock import MonotonicClock, SimulatedClock

BY_USER = "The user ended this flight."
_LEAST_FRAME_SHARE = 0.8
_LONGEST_GAP_S = 0.3
_LEAST_STEP_SHARE = 0.8


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """What came of a flight, and where its files are.

    Attributes:
        exit_code: 0 if it was flown as wanted; see `follower sim --help`.
        folder: the report, and the recording if there is one.
        end: how it ended.
        score: held against the truth; units stand in the names, shares go from 0 to 1.
        violations: what went over the wire that never may, of a program's flight.
        too_slow: in what this computer was too slow or too busy, a sentence each; it spoils the
            figures of a flight in real time.

    Examples:
        >>> import follower
        >>> result = follower.simulate("winding", vision="truth+noise", scene=["duration_s=30"])
        >>> print(result.folder, result.end.sentence, result.score.line_of_sight_rms_deg < 5)
        runs/winding The pursuit succeeded True
    """

    exit_code: int
    folder: Path
    end: FlightEnd
    score: PursuitScore
    violations: tuple[str, ...] = ()
    too_slow: tuple[str, ...] = ()


def simulate(options: SimulationOptions, console: Console | None = None) -> SimulationResult:
    """Fly and write the report.

    Args:
        options: what to fly.
        console: is told how it goes; the terminal by default.

    Raises:
        SettingsError: an option, the scenario or a setting cannot be used.
        ConnectionFailedError: no autopilot answers.
    """
    return _Simulation(options, console or lasting_console()).run()


class _Simulation:
    """One flight with all that shows and keeps it."""

    def __init__(self, options: SimulationOptions, console: Console) -> None:
        self.options = options
        self.console = console
        self.faults = tuple(PlannedFault.parse(text) for text in options.faults)
        self.scenario, self.settings = options.resolve()
        for one in self.faults:
            one.check_begins_by(self.scenario.duration_s)
        self.connection = AutopilotConnection(
            options.autopilot, options.lockstep, options.connect, options.program
        )
        self.sitl: SitlSession | None = None
        self.injector: FaultInjector | None = None
        self.video: OverlayVideo | BackgroundVideo | None = None
        self.recorder: Recorder | None = None
        self.station: UiProcessClient | None = None
        self.flown = False
        self.interrupted = False

    def run(self) -> SimulationResult:
        """Fly and write the report."""
        if self.faults:
            self.connection.check_simulated("--fault")
        # Autopilot, camera, vision and control share few cores: OpenCV's threads would take them.
        cv2.setNumThreads(1)
        with self.connection.open(self.console) as ends:
            with self.console.status("Building the world"):
                world = World(self.scenario, self.options.seed)
                if self.options.vision is VisionSource.PIXELS or self.options.video:
                    _ = world.ground, world.sky, world.scenery_batch  # takes seconds
            # A flight has its own way to end; the files after it are written whole.
            with StopOnInterrupt() as early:
                folder = new_run_folder(self.options.out, self.scenario.name)
                try:
                    flight = self._fly(world, ends, folder, early)
                finally:
                    if not self.flown:
                        remove_run_folder(folder)
                injector = self.injector
                judged = [] if injector is None else verdicts(self.faults, flight, injector)
                remarks = (*self._remarks(flight), *map(describe_verdict, judged))
                to = f"{self.settings.link.kind}, {self.options.connect or 'UDP on this computer'}"
                link = "through memory" if self.options.lockstep else f"by {to}"
                program = self.options.program
                autopilot = flight.flavour if program is None else program.title
                died = None if self.sitl is None else self.sitl.death
                why = BY_CTRL_C if self.interrupted else died
                command = self.options.command
                score = flight.score()
                end = report_flight(
                    flight, score, folder, command, autopilot, link, remarks, self.console, why
                )
        violations = () if self.sitl is None else self.sitl.violations(flight)
        for violation in violations:
            print_line(self.console, f"Never to be sent: {violation}", "bold red")
        if end is BY_CTRL_C or not (judged or violations):
            code = end.exit_code
        else:
            code = FAILED if violations or not all(one.passed for one in judged) else SUCCESS
        return SimulationResult(code, folder, end, score, violations, self._too_slow(flight))

    def _fly(
        self,
        world: World,
        ends: tuple[Transport, Transport],
        folder: Path,
        early: StopOnInterrupt,
    ) -> SimulatedFlight:
        """Fly to the end and return the flight."""
        lockstep, flavour = self.connection.lockstep, self.connection.flavour
        clock = SimulatedClock() if lockstep else MonotonicClock(self.options.setup.speedup)
        with ExitStack() as stack:
            wanted = as_faults_want(self.faults, self.settings, ends, clock)
            settings, ends = stack.enter_context(wanted)
            if (program := self.options.program) is not None:
                setup = self.options.setup
                session = SitlSession(program, setup, world, folder, ends[0], clock)
                self.sitl = stack.enter_context(session)
                ends = session.transport, ends[1]
            if self.faults:
                injector = FaultInjector(self.faults, clock, flavour, world.seed)
                self.injector = stack.enter_context(injector)
            if self.options.video:
                kind = OverlayVideo if lockstep else BackgroundVideo
                self.video = kind(folder / VIDEO, self.scenario.camera.rate_hz)
                stack.enter_context(self.video)
            if self.options.recorded:
                self.recorder = self._recorder(settings, clock, folder, world.seed)
                stack.enter_context(self.recorder)
            self.station = self._open_station(settings, folder)
            stack.enter_context(self.station or nullcontext())
            extras = self._extras(settings)
            flight = SimulatedFlight(world, settings, flavour, clock, ends, extras)
            self.interrupted = self._fly_to_its_end(flight, clock, early)
        return flight

    def _extras(self, settings: Settings) -> FlightOptions:
        videos = [one for one in (self.video, self.station) if one is not None]
        return FlightOptions(
            video=SeveralVideos(videos) if videos else None,
            recorder=self.recorder,
            parts=self.injector,
            vision=self.options.vision,
            finder=operators_finder(settings, self.options.cockpit),
            boots_within_s=None if self.sitl is None else self.sitl.boots_within_s,
        )

    def _remarks(self, flight: SimulatedFlight) -> tuple[str, ...]:
        """Return what the report's reader has to know."""
        remarks = (
            *(() if self.sitl is None else self.sitl.remarks()),
            f"{NO_PIXELS}; not recorded" if self.options.vision is VisionSource.TRUTH else None,
            BY_USER if self.interrupted else None,
            *self._too_slow(flight),
            self.video.remark if self.video else None,
            self.station.remark if self.station else None,
            *(() if self.recorder is None else self.recorder.remarks),
        )
        return tuple(remark for remark in remarks if remark)

    def _fly_to_its_end(
        self,
        flight: SimulatedFlight,
        clock: SimulatedClock | MonotonicClock,
        early: StopOnInterrupt,
    ) -> bool:
        """Fly and show it to the user; return whether they ended it."""
        if self.options.cockpit:
            flight.operate()
        page = None if self.station is None else FlightPublisher(self.station, flight)
        terminal = FlightDisplay(self.console, self.scenario.title)
        ground_station: AbstractContextManager[None] = nullcontext()
        if isinstance(clock, MonotonicClock):  # a simulated clock has no time for ground stations
            save = partial(flight.requests.save, self.options.config)
            rate_hz = self.scenario.camera.rate_hz
            ground_station = open_ground_station(flight.settings, flight.view, rate_hz, clock, save)
        noting = noting_failed_plugins(flight.log, clock.now)
        ending = StopOnInterrupt(flight.stop)
        with closing(flight), ground_station, noting, terminal, ending as interrupt:
            if early.interrupted:
                flight.stop()
            keyboard = Keyboard(sys.stdin)

            def show() -> None:
                if self.sitl is not None:
                    self.sitl.step(flight)
                if self.recorder is not None and self.recorder.must_stop:
                    flight.stop(NOT_RECORDED)
                status = flight.status()
                terminal.show(status)
                if page is not None:
                    page.show(status)
                if flight.settings.consent.kind == "terminal":
                    flight.stage.order(keyboard.order())

            self.flown = True
            try:
                if isinstance(clock, SimulatedClock):
                    fly_lockstep(flight, clock, show, paced=self.options.cockpit)
                else:
                    fly_realtime(flight, clock, show)
            except InjectedDeathError:
                pass
            except ConnectionFailedError as error:
                self.flown = False
                if self.sitl is None:
                    raise
                raise self.sitl.explained(error) from error
        return interrupt.interrupted or early.interrupted

    def _too_slow(self, flight: SimulatedFlight) -> tuple[str, ...]:
        slow = (
            None if self.sitl is None else self.sitl.too_slow(flight),
            self._late_frames(flight),
            self._late_control(flight),
        )
        return tuple(remark for remark in slow if remark)

    def _late_frames(self, flight: SimulatedFlight) -> str | None:
        silent = self.faults or any(one.kind == "silent" for one in self.scenario.faults)
        if flight.lockstep or silent or self.options.vision is VisionSource.TRUTH:
            return None
        return late_frame_warning(flight.log, self.scenario.camera.rate_hz)

    def _late_control(self, flight: SimulatedFlight) -> str | None:
        if flight.lockstep or self.faults:
            return None
        return late_control_warning(flight.log, flight.settings.control_rate_hz)

    def _open_station(self, settings: Settings, folder: Path) -> UiProcessClient | None:
        """Start the process that shows the flight to others, None if it is not wanted."""
        recording = folder.name if self.options.recorded else ""
        page = initial_state("sim", self.scenario.title, settings, recording)
        say = partial(print_line, self.console)
        return open_station(settings, self.options.cockpit, page, self.options.out, say)

    def _recorder(
        self, settings: Settings, clock: SimulatedClock | MonotonicClock, folder: Path, seed: int
    ) -> Recorder:
        lockstep = self.connection.lockstep
        config = FlightConfig.of(
            "simulated",
            settings,
            run={
                "scenario": self.scenario.name,
                "title": self.scenario.title,
                "autopilot": self.connection.flavour,
                "seed": seed,
                "lockstep": lockstep,
                "detection": INLINE if lockstep else late_detection(settings),
                "command": self.options.command,
            },
            camera=self.scenario.camera.model,
            epoch_ns=epoch_ns(clock),
        )
        return Recorder(folder, config, clock, settings.recorder, threaded=not lockstep)


def late_frame_warning(log: FlightLog, camera_hz: float) -> str | None:
    """Return a remark on a flight in which frames came late, None if they did not.

    Args:
        log: of the flight.
        camera_hz: frames a second that the camera takes.
    """
    captured_s = np.array([record.captured_s for record in log.tracks])
    if len(captured_s) < 2:
        return None
    seen_hz = (len(captured_s) - 1) / float(captured_s[-1] - captured_s[0])
    gap_s = float(np.diff(captured_s).max())
    if seen_hz >= _LEAST_FRAME_SHARE * camera_hz and gap_s <= _LONGEST_GAP_S:
        return None
    return (
        f"Frames came late: vision saw {seen_hz:.0f} of the camera's {camera_hz:.0f} frames a "
        f"second, with gaps of up to {gap_s:.1f} s. This computer is too slow or too busy for real "
        "time; --lockstep does not depend on it."
    )


def late_control_warning(log: FlightLog, rate_hz: float) -> str | None:
    """Return a remark on a flight in which control was too slow, None if it was not.

    Args:
        log: of the flight.
        rate_hz: control steps a second that were wanted.
    """
    began_s = np.array([record.time_s for record in log.controls])
    if len(began_s) < 2:
        return None
    flown_hz = (len(began_s) - 1) / float(began_s[-1] - began_s[0])
    if flown_hz >= _LEAST_STEP_SHARE * rate_hz:
        return None
    busy_ms = 1e3 * float(np.median([record.busy_s for record in log.controls]))
    return (
        f"Control came late: {flown_hz:.0f} of the wanted {rate_hz:.0f} steps a second, and "
        f"{busy_ms:.1f} ms of work in one. This computer is too busy, or a part of another package "
        "too slow."
    )
