"""`follower fly`: preflight, wait for the pilot, follow, release, report."""

import sys
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import cv2
from rich.console import Console

from follower.apps.bench.last import last_bench, more_than_held
from follower.apps.fly.flight import RealFlight
from follower.apps.fly.opened import FlightPlan, OpenedFlight, opened_flight
from follower.apps.preflight.check import PreflightError, PreflightResult
from follower.apps.preflight.checklist import (
    check_list,
    checklist,
    live_checklist,
    print_checklist,
)
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
from follower.recording import Recorder
from follower.recording.recorded_flight import open_flight
from follower.recording.run_folder import (
    RunFiles,
    new_run_folder,
    remove_run_folder,
    write_boxes,
    write_setpoints,
)
from follower.ui.cockpit.publisher import FlightPublisher, PeriodicPublisher, initial_state
from follower.ui.cockpit.start import open_station
from follower.ui.ground_station.server import operators_finder
from follower.ui.ipc.server_client import UiProcessClient
from follower.ui.terminal.console import lasting_console, print_line
from follower.ui.terminal.flight_display import FlightDisplay
from follower.ui.terminal.interrupt import InterruptFlag, Keyboard, StopOnInterrupt, stop_signals
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import Transport
from follower_vision.clock import MonotonicClock
from follower_vision.fusion import BackgroundDetection
from follower_vision.trackers.target_tracker import TargetTracker


def fly(plan: FlightPlan, cockpit: bool = False) -> int:
    """Fly, and return the exit code: the flight end's, or 1 if the preflight checks refused it.

    Args:
        plan: what is to be flown; the recording goes into its checks' folder.
        cockpit: whether the web page is opened.

    Raises:
        ValueError, OSError: what the user can mend, in one line; nothing is left behind then.
    """
    settings, target = plan.settings, plan.target
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
        transport = open_connection(plan.connect)
        stack.callback(transport.close)
        folder = new_run_folder(plan.checks.folder, "fly")
        session = FlySession(plan, cockpit, folder)
        try:
            return session.run(transport, tracker, selector, pressed)
        finally:
            if not session.flown:
                remove_run_folder(folder)


@dataclass(slots=True)
class FlySession:
    """One run of `follower fly` in front of a user.

    Attributes:
        plan: what is to be flown.
        cockpit: whether the web page is opened.
        folder: takes the recording.
        flown: the checks were passed: there is a flight to report on.
    """

    plan: FlightPlan
    cockpit: bool
    folder: Path
    flown: bool = False
    _console: Console = field(default_factory=lasting_console)
    _clock: MonotonicClock = field(default_factory=MonotonicClock)
    _station: UiProcessClient | None = None
    _told: int = 0

    def run(
        self,
        transport: Transport,
        tracker: TargetTracker,
        selector: Selector | None,
        pressed: InterruptFlag,
    ) -> int:
        """Check, fly, report; return the exit code. Ctrl-C before the flight ends it.

        Args:
            transport: to the autopilot.
            tracker: follows the target.
            selector: finds the target; None leaves that to the operators.
            pressed: whether Ctrl-C was.
        """
        with ExitStack() as after:
            self._station = self._open_station(after)
            with opened_flight(self.plan, self.folder, transport, self._clock) as opened:
                results = self._check(opened, pressed)
                finder = operators_finder(self.plan.settings, self.cockpit)
                try:
                    flight = opened.ready(tracker, finder, self._station)
                except PreflightError:
                    names = " ".join(
                        f"--skip-preflight {r.check.name}" for r in results if r.refuses
                    )
                    self._say(f"Mend it, or fly on your own responsibility with {names}")
                    return FAILED
                self._warn_of_rate(flight.size, opened.rate_hz)
                end = self._fly(opened, flight, selector, after)
            self._report(opened.recorder)
            self._say(end.sentence)
        return end.exit_code

    def _check(self, opened: OpenedFlight, pressed: InterruptFlag) -> list[PreflightResult]:
        """Run the checks and show them; Ctrl-C ends them."""
        with live_checklist(self._console) as live:

            def show(results: list[PreflightResult]) -> None:
                pressed.check()
                live.update(checklist(results), refresh=True)
                self._show_checks(results)

            results = opened.check(show)
        print_checklist(self._console, results)
        self._show_checks(results)
        return results

    def _warn_of_rate(self, size: tuple[int, int], rate_hz: float) -> None:
        """Say if vision will not keep up with the camera, as far as a bench has shown."""
        said = more_than_held(self.plan.settings, size, rate_hz, last_bench())
        if said is not None:
            self._say(said)

    def _open_station(self, stack: ExitStack) -> UiProcessClient | None:
        """Open what shows the flight to others, if anybody wants to see it."""
        page = initial_state("fly", self.plan.shown_target, self.plan.settings, self.folder.name)
        runs = self.plan.checks.folder
        station = open_station(self.plan.settings, self.cockpit, page, runs, self._say)
        return None if station is None else stack.enter_context(station)

    def _show_checks(self, results: list[PreflightResult]) -> None:
        if self._station is not None:
            self._station.tell_page({"preflight": check_list(results)})

    def _fly(
        self,
        opened: OpenedFlight,
        flight: RealFlight,
        selector: Selector | None,
        after: ExitStack,
    ) -> FlightEnd:
        """Fly to the end, or until Ctrl-C; the next one, until `after` is closed, is let pass."""
        if selector is not None:
            flight.select(selector)
        self.flown = True
        keyboard = Keyboard(sys.stdin)
        terminal = FlightDisplay(self._console, f"Following {self.plan.shown_target}")
        with opened.ground_station(flight), self._page(flight), terminal:

            def watch(flight: RealFlight) -> None:
                if opened.recorder.must_stop:
                    flight.stop(NOT_RECORDED)
                self._tell(opened.recorder)
                terminal.show(flight.status(self.plan.shown_target))
                self._take_order(flight, keyboard.order())

            after.enter_context(StopOnInterrupt(flight.stop))
            flight.run(watch)
            after.enter_context(StopOnInterrupt())
        self._say_goodbye(opened.link)
        return flight.end

    def _page(self, flight: RealFlight) -> AbstractContextManager[object]:
        """Show the flight on the page while entered, if there is one."""
        if self._station is None:
            return nullcontext()
        page = FlightPublisher(self._station, flight)
        return PeriodicPublisher(lambda: page.show(flight.status(self.plan.shown_target)))

    def _take_order(self, flight: RealFlight, order: ConsentRequest) -> None:
        welcome = self.plan.settings.consent.takes_orders_by("terminal")
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
