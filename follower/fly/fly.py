"""`follower fly`: preflight, wait for the pilot, follow, let go, report."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from functools import partial
from pathlib import Path

import cv2
from rich.console import Console

from follower.cockpit.opening import open_station
from follower.cockpit.showing import FlightShow, SteadyShow, check_list, first_page
from follower.fly.camera import SteadySource, after_preflight, open_camera_or_dead
from follower.fly.keyboard import Keyboard
from follower.fly.options import FlyOptions
from follower.fly.real_flight import RealFlight
from follower.fly.target import target_selector
from follower.ground_station.flight_view import FlightView
from follower.ground_station.opening import open_ground_station, operators_finder
from follower.interrupt import StopOnInterrupt
from follower.links.connection import open_connection
from follower.links.link import Link
from follower.links.opening import open_link
from follower.outputs import write_boxes, write_setpoints
from follower.preflight.camera_watch import CameraWatch
from follower.preflight.check import Result
from follower.preflight.observing import Observation, Surroundings
from follower.preflight.running import check_names
from follower.preflight.showing import LiveChecklist, print_checklist, to_json
from follower.print_line import print_line
from follower.recorder import FlightConfig, Recorder, epoch_now_ns
from follower.recorder.recorded_flight import open_flight
from follower.run_folder import new_run_folder, remove_run_folder
from follower.settings import Settings
from follower.situation import Order
from follower.station.station import Station
from follower.terminal import Terminal
from follower.tracking import make_settings_detector, make_target_tracker
from follower.vision_stage import Selector
from follower.watched import Pressed, stop_signals
from follower_control.transport import Transport
from follower_vision.clock import MonotonicClock
from follower_vision.framesource import FrameSource, SourceError
from follower_vision.fusion import BackgroundDetection
from follower_vision.target_tracker import TargetTracker

_SUCCESS, _REFUSED = 0, 1
_KEPT = 3000
"""A minute of control steps stays in memory, for the terminal; the recording has them all."""
PREFLIGHT = "preflight.json"


def fly(options: FlyOptions) -> int:
    """Fly, and return the exit code: 0 after a flight, 1 if the preflight checks refused it.

    Raises:
        ValueError, OSError: what the user can mend, in one line; nothing is left behind then.
    """
    skip = check_names(options.skip)
    settings = options.settings()
    selector = None
    if options.names_target:
        selector = target_selector(options, make_settings_detector(settings))
    cv2.setNumThreads(1)
    with stop_signals() as pressed, ExitStack() as stack:
        tracker = make_target_tracker(settings, BackgroundDetection)
        stack.callback(getattr(tracker, "close", _nothing))
        transport = open_connection(options.connect)
        stack.callback(transport.close)
        folder = new_run_folder(options.out, "fly")
        session = FlySession(options, settings, selector, tracker, skip, folder)
        try:
            return session.run(transport, pressed)
        finally:
            if not session.flown:
                remove_run_folder(folder)


def _nothing() -> None:
    """Do nothing: a tracker without threads needs no closing."""


class FlySession:
    """One run of `follower fly` in front of a user.

    Args:
        options: as given.
        settings: as resolved.
        selector: finds the target; None leaves that to the cockpit.
        tracker: follows it.
        skip: names of checks that do not refuse.
        folder: takes the recording.

    Attributes:
        flown: the checks were passed: there is a flight to report on.
    """

    def __init__(
        self,
        options: FlyOptions,
        settings: Settings,
        selector: Selector | None,
        tracker: TargetTracker,
        skip: frozenset[str],
        folder: Path,
    ) -> None:
        self._options = options
        self._settings = settings
        self._selector = selector
        self._tracker = tracker
        self._skip = skip
        self._folder = folder
        self._console = Console()
        self._clock = MonotonicClock()
        self._station: Station | None = None
        self.flown = False

    def run(self, transport: Transport, pressed: Pressed) -> int:
        """Check, fly, report; return the exit code. Ctrl-C before the flight ends it."""
        with ExitStack() as after:
            self._station = self._open_station(after)
            with self._recorder() as recorder, self._link(recorder.transport(transport)) as link:
                source = open_camera_or_dead(self._options, self._clock)
                with ExitStack() as stack:
                    stack.callback(lambda: source.close())
                    size = self._check(link, source, pressed)
                    if size is None:
                        return _REFUSED
                    source = after_preflight(source, self._options, self._clock)
                    self._fly(link, SteadySource(source, size), size, recorder, after)
            self._report(recorder)
        return _SUCCESS

    @contextmanager
    def _recorder(self) -> Iterator[Recorder]:
        config = FlightConfig.of(
            "real",
            self._settings,
            run={
                "source": self._options.shown_camera,
                "connect": self._options.connect,
                "target": self._options.wish,
                "detection": "background",
                "command": self._options.command,
            },
            epoch_ns=epoch_now_ns(self._clock),
        )
        settings = self._settings.recorder
        recorder = Recorder(self._folder, config, self._clock, settings, kept=_KEPT)
        with recorder:
            yield recorder

    @contextmanager
    def _link(self, transport: Transport) -> Iterator[Link]:
        epoch_ns = epoch_now_ns(self._clock)
        with closing(open_link(transport, self._settings.link, self._clock, epoch_ns)) as link:
            yield link

    def _check(self, link: Link, source: FrameSource, pressed: Pressed) -> tuple[int, int] | None:
        """Run the checks; return the size of the frames, None if somebody has to mend something.

        Raises:
            SourceError: the target lies outside the image.
        """
        about = Surroundings(self._settings, self._options.out, self._options.lens_given)
        name = self._options.shown_camera
        with CameraWatch(source, name, self._clock) as camera, LiveChecklist(self._console) as live:
            observation = Observation(link, camera, self._clock, about)

            def show(results: list[Result]) -> None:
                pressed.check()
                live.show(results)
                self._show_checks(results)

            results = observation.run(self._skip, show, self._options.look_s)
            snapshot = observation.snapshot(self._clock.now())
        print_checklist(self._console, results)
        self._show_checks(results)
        if any(result.refuses for result in results) or snapshot.camera.size is None:
            self._advise(results)
            return None
        self._check_target(snapshot.camera.size)
        (self._folder / PREFLIGHT).write_text(to_json(results, snapshot) + "\n", "utf-8")
        return snapshot.camera.size

    def _open_station(self, stack: ExitStack) -> Station | None:
        """Open what shows the flight to others, if anybody wants to see it."""
        page = first_page("fly", self._options.wish, self._settings, self._folder.name)
        cockpit, runs = self._options.cockpit, self._options.out
        station = open_station(self._settings, cockpit, page, runs, self._say)
        return None if station is None else stack.enter_context(station)

    def _show_checks(self, results: list[Result]) -> None:
        if self._station is not None:
            self._station.tell_page({"preflight": check_list(results)})

    def _advise(self, results: list[Result]) -> None:
        names = " ".join(f"--skip-preflight {r.check.name}" for r in results if r.refuses)
        self._say(f"Mend it, or fly on your own responsibility with {names}")

    def _check_target(self, size: tuple[int, int]) -> None:
        target = self._options.target
        if target is not None and target.visible_share(*size) <= 0:
            raise SourceError(f"--target lies outside the image, which is {size[0]}x{size[1]}")

    def _fly(
        self,
        link: Link,
        source: SteadySource,
        size: tuple[int, int],
        recorder: Recorder,
        after: ExitStack,
    ) -> None:
        """Fly to the end, or until Ctrl-C; the next one, until `after` is closed, is let pass."""
        flight = RealFlight(
            self._settings,
            source,
            size,
            link,
            self._tracker,
            self._clock,
            recorder.log,
            operators_finder(self._settings, self._options.cockpit),
            video=self._station,
        )
        view = FlightView(recorder.log, link, flight.requests, size)
        save = partial(flight.requests.save, self._options.config)
        rate_hz = source.nominal_rate_hz
        ground = open_ground_station(self._settings, view, rate_hz, self._clock, save)
        if self._selector is not None:
            flight.select(self._selector)
        self.flown = True
        keyboard = Keyboard(sys.stdin)
        terminal = Terminal(self._console, f"Following {self._options.wish}")
        with ground, self._page(flight), terminal:

            def watch(flight: RealFlight) -> None:
                terminal.show(flight.status(self._options.wish))
                self._take_order(flight, keyboard.order())

            after.enter_context(StopOnInterrupt(flight.stop))
            flight.run(watch)
            after.enter_context(StopOnInterrupt())
        self._say_goodbye(link)

    def _page(self, flight: RealFlight) -> AbstractContextManager[object]:
        """Show the flight on the page while entered, if there is one."""
        if self._station is None:
            return nullcontext()
        page, wish = FlightShow(self._station, flight), self._options.wish
        return SteadyShow(lambda: page.show(flight.status(wish)))

    def _take_order(self, flight: RealFlight, order: Order) -> None:
        welcome = self._settings.consent.takes_orders_by("terminal")
        if order is Order.WITHDRAW or (order is Order.GIVE and welcome):
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
        from follower.inspection import inspect_recorded

        recorded = open_flight(self._folder)
        write_boxes(self._folder / "boxes.csv", recorded.log.tracks)
        write_setpoints(self._folder / "setpoints.csv", recorded.log.controls)
        for remark in recorder.remarks:
            self._say(remark)
        inspect_recorded(recorded, console=self._console)

    def _say(self, text: str) -> None:
        print_line(self._console, text)
