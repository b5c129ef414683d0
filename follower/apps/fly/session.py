"""`follower fly`: preflight, wait for the pilot, follow, release, report."""

import sys
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import cv2
from rich.console import Console

from follower.apps.bench.last import last_bench, more_than_held
from follower.apps.command_settings import command_line
from follower.apps.fly.flight import RealFlight
from follower.apps.preflight.camera_checks import CameraWatch
from follower.apps.preflight.check import PreflightResult
from follower.apps.preflight.checklist import (
    check_list,
    checklist,
    live_checklist,
    print_checklist,
    to_json,
)
from follower.apps.preflight.session import CheckScope, LinkObserver
from follower.apps.target_choice import TargetChoice
from follower.apps.video_input import SteadySource, VideoInput
from follower.flight.supervision.flight_end import FAILED, NOT_RECORDED, FlightEnd
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.target.selectors import Selector, first_selected
from follower.flight.vision.tracker_factory import (
    close_tracker,
    make_settings_detector,
    make_target_tracker,
)
from follower.links.connections import open_connection
from follower.links.link import Link
from follower.links.open import open_link
from follower.recording import FlightConfig, Recorder, epoch_now_ns
from follower.recording.recorded_flight import open_flight
from follower.recording.run_folder import (
    RunFiles,
    new_run_folder,
    remove_run_folder,
    write_boxes,
    write_setpoints,
)
from follower.settings.settings import Settings
from follower.ui.cockpit.publisher import FlightPublisher, PeriodicPublisher, initial_state
from follower.ui.cockpit.start import open_station
from follower.ui.ground_station.flight_view import FlightView
from follower.ui.ground_station.server import open_ground_station, operators_finder
from follower.ui.ipc.server_client import UiProcessClient
from follower.ui.terminal.console import print_line
from follower.ui.terminal.flight_display import FlightDisplay
from follower.ui.terminal.interrupt import InterruptFlag, Keyboard, StopOnInterrupt, stop_signals
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import Transport
from follower_vision.atomic_file import write_whole
from follower_vision.clock import MonotonicClock
from follower_vision.fusion import BackgroundDetection
from follower_vision.sources.frame_source import FrameSource, SourceError
from follower_vision.trackers.target_tracker import TargetTracker

_KEPT = 3000
"""A minute of control steps stays in memory, for the terminal; the recording has them all."""
PREFLIGHT = "preflight.json"


def fly(
    settings: Settings,
    target: TargetChoice,
    camera: VideoInput,
    connect: str,
    checks: CheckScope,
    *,
    cockpit: bool = False,
    config: Path | None = None,
) -> int:
    """Fly, and return the exit code: the flight end's, or 1 if the preflight checks refused it.

    Args:
        settings: to fly with.
        target: chosen before the flight; none leaves that to the operators.
        camera: source of the frames.
        connect: where the autopilot speaks MAVLink.
        checks: before the flight; the recording goes into their folder.
        cockpit: whether the web page is opened.
        config: settings file into which changed settings are saved.

    Raises:
        ValueError, OSError: what the user can mend, in one line; nothing is left behind then.
    """
    if not (target.given or cockpit or settings.ground_station.enabled):
        raise SettingsError(
            "which target? give --select person, --colour '#rrggbb' or --target x,y,w,h, or "
            "--cockpit to choose it on a page, or --set ground_station.enabled=true for a "
            "ground station"
        )
    selector = None
    if target.given:
        selector = first_selected(target.selector(make_settings_detector(settings)))
    cv2.setNumThreads(1)
    with stop_signals() as pressed, ExitStack() as stack:
        tracker = make_target_tracker(settings, BackgroundDetection)
        stack.callback(close_tracker, tracker)
        transport = open_connection(connect)
        stack.callback(transport.close)
        folder = new_run_folder(checks.folder, "fly")
        session = FlySession(settings, target, camera, checks, cockpit, config, folder)
        try:
            return session.run(transport, connect, tracker, selector, pressed)
        finally:
            if not session.flown:
                remove_run_folder(folder)


@dataclass(slots=True)
class FlySession:
    """One run of `follower fly` in front of a user.

    Attributes:
        settings: to fly with.
        target: chosen before the flight, if it is.
        camera: source of the frames.
        checks: before the flight.
        cockpit: whether the web page is opened.
        config: settings file into which changed settings are saved.
        folder: takes the recording.
        flown: the checks were passed: there is a flight to report on.
    """

    settings: Settings
    target: TargetChoice
    camera: VideoInput
    checks: CheckScope
    cockpit: bool
    config: Path | None
    folder: Path
    flown: bool = False
    _console: Console = field(default_factory=Console)
    _clock: MonotonicClock = field(default_factory=MonotonicClock)
    _station: UiProcessClient | None = None
    _told: int = 0

    @property
    def _target(self) -> str:
        if self.target.given:
            return str(self.target)
        return f"what the {'cockpit' if self.cockpit else 'ground station'} selects"

    def run(
        self,
        transport: Transport,
        connect: str,
        tracker: TargetTracker,
        selector: Selector | None,
        pressed: InterruptFlag,
    ) -> int:
        """Check, fly, report; return the exit code. Ctrl-C before the flight ends it.

        Args:
            transport: to the autopilot.
            connect: its address, for the recording.
            tracker: follows the target.
            selector: finds the target; None leaves that to the operators.
            pressed: whether Ctrl-C was.
        """
        with ExitStack() as after:
            self._station = self._open_station(after)
            epoch_ns, settings = epoch_now_ns(self._clock), self.settings
            with (
                self._recorder(connect, epoch_ns) as recorder,
                closing(
                    open_link(recorder.transport(transport), settings.link, self._clock, epoch_ns)
                ) as link,
            ):
                source = self.camera.open_or_dead(self._clock)
                with ExitStack() as stack:
                    stack.callback(lambda: source.close())
                    size = self._check(link, source, pressed)
                    if size is None:
                        return FAILED
                    source = self.camera.restarted(source, self._clock)
                    steady = SteadySource(source, size)
                    self._warn_of_rate(size, source.nominal_rate_hz)
                    end = self._fly(link, steady, size, tracker, selector, recorder, after)
            self._report(recorder)
            self._say(end.sentence)
        return end.exit_code

    def _recorder(self, connect: str, epoch_ns: int) -> Recorder:
        config = FlightConfig.of(
            "real",
            self.settings,
            run={
                "source": self.camera.shown,
                "connect": connect,
                "target": self._target,
                "detection": "background",
                "command": command_line(),
            },
            epoch_ns=epoch_ns,
        )
        return Recorder(self.folder, config, self._clock, self.settings.recorder, kept=_KEPT)

    def _check(
        self, link: Link, source: FrameSource, pressed: InterruptFlag
    ) -> tuple[int, int] | None:
        """Run the checks; return the size of the frames, None if somebody has to mend something.

        Raises:
            SourceError: the target lies outside the image.
        """
        with (
            CameraWatch(source, self.camera.shown, self._clock) as camera,
            live_checklist(self._console) as live,
        ):
            observer = LinkObserver(link, camera, self._clock, self.settings, self.checks)

            def show(results: list[PreflightResult]) -> None:
                pressed.check()
                live.update(checklist(results), refresh=True)
                self._show_checks(results)

            results = observer.run(show)
            snapshot = observer.snapshot(self._clock.now())
        print_checklist(self._console, results)
        self._show_checks(results)
        if any(result.refuses for result in results) or snapshot.camera.size is None:
            names = " ".join(f"--skip-preflight {r.check.name}" for r in results if r.refuses)
            self._say(f"Mend it, or fly on your own responsibility with {names}")
            return None
        width, height = snapshot.camera.size
        if any(box.visible_share(width, height) <= 0 for box in self.target.boxes):
            raise SourceError(f"--target lies outside the image, which is {width}x{height}")
        said = to_json(results, snapshot) + "\n"
        RunFiles(self.folder).write(PREFLIGHT, lambda path: write_whole(path, said))
        return snapshot.camera.size

    def _warn_of_rate(self, size: tuple[int, int], rate_hz: float) -> None:
        """Say if vision will not keep up with the camera, as far as a bench has shown."""
        said = more_than_held(self.settings, size, rate_hz, last_bench())
        if said is not None:
            self._say(said)

    def _open_station(self, stack: ExitStack) -> UiProcessClient | None:
        """Open what shows the flight to others, if anybody wants to see it."""
        page = initial_state("fly", self._target, self.settings, self.folder.name)
        runs = self.checks.folder
        station = open_station(self.settings, self.cockpit, page, runs, self._say)
        return None if station is None else stack.enter_context(station)

    def _show_checks(self, results: list[PreflightResult]) -> None:
        if self._station is not None:
            self._station.tell_page({"preflight": check_list(results)})

    def _fly(
        self,
        link: Link,
        source: SteadySource,
        size: tuple[int, int],
        tracker: TargetTracker,
        selector: Selector | None,
        recorder: Recorder,
        after: ExitStack,
    ) -> FlightEnd:
        """Fly to the end, or until Ctrl-C; the next one, until `after` is closed, is let pass."""
        flight = RealFlight(
            self.settings,
            source,
            size,
            link,
            tracker,
            self._clock,
            recorder.log,
            operators_finder(self.settings, self.cockpit),
            video=self._station,
        )
        view = FlightView(recorder.log, link, flight.requests, size)
        save = partial(flight.requests.save, self.config)
        rate_hz = source.nominal_rate_hz
        ground = open_ground_station(self.settings, view, rate_hz, self._clock, save)
        if selector is not None:
            flight.select(selector)
        self.flown = True
        keyboard = Keyboard(sys.stdin)
        terminal = FlightDisplay(self._console, f"Following {self._target}")
        with ground, self._page(flight), terminal:

            def watch(flight: RealFlight) -> None:
                if recorder.must_stop:
                    flight.stop(NOT_RECORDED)
                self._tell(recorder)
                terminal.show(flight.status(self._target))
                self._take_order(flight, keyboard.order())

            after.enter_context(StopOnInterrupt(flight.stop))
            flight.run(watch)
            after.enter_context(StopOnInterrupt())
        self._say_goodbye(link)
        return flight.end

    def _page(self, flight: RealFlight) -> AbstractContextManager[object]:
        """Show the flight on the page while entered, if there is one."""
        if self._station is None:
            return nullcontext()
        page = FlightPublisher(self._station, flight)
        return PeriodicPublisher(lambda: page.show(flight.status(self._target)))

    def _take_order(self, flight: RealFlight, order: ConsentRequest) -> None:
        welcome = self.settings.consent.takes_orders_by("terminal")
        if order is ConsentRequest.WITHDRAW or (order is ConsentRequest.GIVE and welcome):
            flight.log.note(self._clock.now(), "operator", f"consent: {order} at the terminal")
            flight.stage.order(order)

    def _say_goodbye(self, link: Link) -> None:
        vehicle = link.state
        if vehicle.armed and vehicle.obeys_setpoints:
            self._say(
                f"The vehicle is still in {vehicle.mode} and gets no setpoints any more: pilot, "
                "take it over now"
            )

    def _report(self, recorder: Recorder) -> None:
        # Plots need matplotlib, which has no place in a flight: it comes when that is over.
        from follower.apps.inspect import REPORT, inspect_recorded

        recorded, written = open_flight(self.folder), RunFiles(self.folder)
        written.write("boxes.csv", lambda path: write_boxes(path, recorded.log.tracks))
        written.write("setpoints.csv", lambda path: write_setpoints(path, recorded.log.controls))
        self._tell(recorder)
        written.write(REPORT, lambda _: inspect_recorded(recorded, console=self._console))
        for remark in written.remarks:
            self._say(remark)

    def _tell(self, recorder: Recorder) -> None:
        """Say what the recorder has remarked since the last time."""
        remarks = recorder.remarks[self._told :]
        self._told += len(remarks)
        for remark in remarks:
            self._say(remark)

    def _say(self, text: str) -> None:
        print_line(self._console, text)
