"""A real vehicle that follows, for as long as a `with` block runs."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from follower.apps.command_settings import command_settings, lens_is_given, with_needed_detector
from follower.apps.fly.flight import RealFlight
from follower.apps.fly.opened import FlightPlan, OpenedFlight, opened_flight
from follower.apps.preflight.checklist import check_names
from follower.apps.preflight.session import CheckScope
from follower.apps.target_choice import TargetChoice
from follower.apps.video_input import VideoInput
from follower.flight.status import LiveStatus
from follower.flight.supervision.flight_end import NOT_RECORDED, FlightEnd
from follower.flight.target.selectors import Selector, check_in_image, first_selected
from follower.flight.threads import one_opencv_thread
from follower.flight.vision.tracker_factory import (
    close_tracker,
    make_settings_detector,
    make_tracker_with,
)
from follower.links.connections import open_connection
from follower.recording.run_folder import new_run_folder, remove_run_folder
from follower.ui.terminal.interrupt import StopOnInterrupt, stop_signals
from follower_control.common.strict_config import SettingsError
from follower_control.common.transport import Transport
from follower_vision.clock import MonotonicClock
from follower_vision.detection import Detector
from follower_vision.fusion import BackgroundDetection
from follower_vision.geometry.box import Box
from follower_vision.trackers.target_tracker import TargetTracker
from follower_vision.trackers.track import Track

_LOOK_EVERY_S = 0.05
_LONGEST_END_S = 15.0
"""Braking, the last holds and closing take no longer."""


class Pursuit:
    """Follows a target with a real vehicle while its `with` block runs.

    The same flight as `follower fly`: preflight checks, supervisor and envelope. It never arms,
    takes off or changes the mode (see `autonomy`); the pilot consents by switching to OFFBOARD or
    GUIDED, and takes over by any other mode. However the block is left, also by an exception,
    Ctrl-C or SIGTERM, the vehicle brakes, holds and is released before the next line runs. After
    a release it follows again only if `consent.again` is "mode". It flies once, prints nothing.

    Args:
        connect: where the autopilot speaks MAVLink: "udpin:0.0.0.0:14540", "/dev/ttyAMA0:921600".
        camera: as `frames` takes it; a recording is played at its own pace.
        target: see `select`; None leaves that for later.
        mode: "chase", "watch", "side", "orbit" or "overhead"; None leaves it to the settings.
        config: settings file.
        overrides: `key=value` each, as `--set` takes them.
        skip_preflight: names of preflight checks that do not refuse, on your responsibility.
        out: folder in which the recording gets its own.

    Attributes:
        folder: the recording; `write_report` and `open_flight` take it after the block.

    Raises:
        SettingsError: a setting, the target or the name of a check cannot be used.
        ModelError: a network is missing.
        ConnectionFailedError: on entering: the connection cannot be opened.
        PreflightError: on entering: checks refuse the flight, of which nothing is left behind.

    Examples:
        >>> import follower
        >>> pursuit = follower.Pursuit(
        ...     "udpin:0.0.0.0:14540", camera=0, mode="chase", config="drone.yaml"
        ... )
        >>> with pursuit:
        ...     pursuit.select("#d02020")  # or a Box, or "car"
        ...     for track in pursuit.tracks():
        ...         if pursuit.status.state == "following":  # the pilot has switched to OFFBOARD
        ...             break
        >>> print(track.state, pursuit.end.sentence, sep=", ")
        tracking, Ended as asked
    """

    def __init__(
        self,
        connect: str,
        *,
        camera: str | int | Path,
        target: Box | str | None = None,
        mode: str | None = None,
        config: str | Path | None = None,
        overrides: Iterable[str] = (),
        skip_preflight: Iterable[str] = (),
        out: str | Path = "runs",
    ) -> None:
        file = None if config is None else Path(config)
        changes = (*(() if mode is None else (f"servo.mode={mode}",)), *overrides)
        choice = TargetChoice() if target is None else TargetChoice.one(target)
        settings = command_settings(file, changes)
        if settings.video.on:
            raise SettingsError("video: live video goes out of `follower fly` alone")
        if settings.consent.kind in ("terminal", "cockpit"):
            raise SettingsError(
                f"consent.kind: {settings.consent.kind}: a program reads no keys and has no page; "
                "take mode, rc or command"
            )
        scope = CheckScope(check_names(skip_preflight), Path(out), lens_is_given(file, changes))
        self._plan = FlightPlan(
            with_needed_detector(settings, bool(choice.select)),
            choice,
            "the program",
            VideoInput.camera(str(camera), settings.camera),
            connect,
            scope,
            file,
        )
        self._first = self._selector(choice) if choice.given else None
        self._owner = threading.current_thread()
        self._ready: RealFlight | None = None
        self._thread: threading.Thread | None = None
        self._given_up = threading.Event()
        self._error: Exception | None = None
        self._open, self._signals = ExitStack(), ExitStack()
        self.folder = Path(out)

    def __enter__(self) -> Self:
        if self._thread is not None:
            raise RuntimeError("a Pursuit flies once: make another one")
        plan, clock = self._plan, self._make_clock()
        with ExitStack() as signals, ExitStack() as stack:
            pressed = signals.enter_context(stop_signals())
            stack.enter_context(one_opencv_thread())
            tracker = make_tracker_with(self._make_detector(), plan.settings, BackgroundDetection)
            stack.callback(close_tracker, tracker)
            transport = self._open_transport()
            stack.callback(transport.close)
            self.folder = new_run_folder(plan.checks.folder, "fly")
            stack.callback(self._leave_nothing)
            opened = stack.enter_context(opened_flight(plan, self.folder, transport, clock))
            opened.check(lambda _: pressed.check())
            self._ready = self._wire(opened, tracker)
            if self._first is not None:
                self._ready.select(self._first)
            stack.callback(self._end)
            self._owner = threading.current_thread()
            # No daemon: a program that ends without leaving the block waits for the release.
            self._thread = threading.Thread(target=self._fly, args=(opened,), name="pursuit")
            self._thread.start()
            self._open, self._signals = stack.pop_all(), signals.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop, hold, release; raise what ended the flight itself, unless the block failed too.

        The first Ctrl-C here is let pass; the second brakes off the flight and interrupts.
        """
        with self._signals, StopOnInterrupt(), self._open:
            pass
        if self._error is None:
            return
        if error is None:
            raise self._error
        error.add_note(f"The flight itself had failed: {self._error!r}")

    def select(self, target: Box | str) -> None:
        """Choose the target anew, in the coming frames, as soon as it is seen. It is no consent.

        Args:
            target: a box in pixels of the next frame; or an object that the detector knows:
                "car", "car:2" for the second from the image's centre; or a colour, "#rrggbb".

        Raises:
            SettingsError: the class or colour is unknown.
            ModelError: a class was given, and the settings name no detector.
            SourceError: less than half of the box lies in the image.
        """
        choice = TargetChoice.one(target)
        for box in choice.boxes:
            check_in_image(box, *self._flight.size)
        self._flight.select(self._selector(choice))

    @property
    def status(self) -> LiveStatus:
        """The present state: supervisor, errors in rad, setpoints in m/s and rad/s, rates, link."""
        return self._flight.status(self._plan.shown_target)

    @property
    def track(self) -> Track | None:
        """The newest track, in pixels; None while no target is chosen."""
        newest = self._flight.tracks.newest
        return None if newest is None else newest.track

    def tracks(self) -> Iterator[Track]:
        """Give each new track, or the newest if the reader is slower, until the flight ends."""
        while self._flying:
            newest = self._flight.tracks.wait(_LOOK_EVERY_S)
            if newest is not None and newest.track is not None:
                yield newest.track

    def wait(self, state: str | None = None, timeout_s: float | None = None) -> bool:
        """Wait for a state of the supervisor, or for the flight's end; Ctrl-C interrupts.

        Args:
            state: "following", "released", …; None waits for the end: of the video, for want of
                room for the recording, or after `stop`.
            timeout_s: at most so many seconds; None waits for ever.

        Returns:
            Whether it came about.
        """
        clock = MonotonicClock()
        until_s = None if timeout_s is None else clock.now() + timeout_s
        while self._flying:
            if state is not None and self.status.state == state:
                return True
            if until_s is not None and clock.now() >= until_s:
                return False
            clock.sleep_until(clock.now() + _LOOK_EVERY_S)
        return state is None

    def stop(self) -> None:
        """Brake, hold, release the vehicle and end the flight; from any thread."""
        self._flight.stop()

    @property
    def end(self) -> FlightEnd:
        """How the flight ended, or would if it ended now."""
        return self._flight.end

    @property
    def _flight(self) -> RealFlight:
        if self._ready is None:
            raise RuntimeError("there is no flight before the `with` block")
        return self._ready

    @property
    def _flying(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _make_detector(self) -> Detector | None:
        return make_settings_detector(self._plan.settings)

    def _make_clock(self) -> MonotonicClock:
        return MonotonicClock()

    def _open_transport(self) -> Transport:
        return open_connection(self._plan.connect)

    def _wire(self, opened: OpenedFlight, tracker: TargetTracker) -> RealFlight:
        return opened.ready(tracker)

    def _selector(self, choice: TargetChoice) -> Selector:
        detector = self._make_detector() if choice.select else None
        return first_selected(choice.selector(detector))

    def _fly(self, opened: OpenedFlight) -> None:
        """Run the flight to its end, on a thread of its own."""

        def watch(flight: RealFlight) -> None:
            if opened.recorder.must_stop:
                flight.stop(NOT_RECORDED)
            if not self._owner.is_alive():
                flight.stop()
            if self._given_up.is_set():
                raise RuntimeError("the flight was given up before it had ended")

        try:
            with opened.ground_station(self._flight):
                self._flight.run(watch)
        except Exception as error:  # raised again where the block is left
            self._error = error

    def _end(self) -> None:
        if self._thread is None or not self._thread.is_alive():
            return
        self._flight.stop()
        try:
            self._thread.join()
        except KeyboardInterrupt:
            self._given_up.set()
            self._thread.join(_LONGEST_END_S)
            raise

    def _leave_nothing(self) -> None:
        if self._thread is None:
            remove_run_folder(self.folder)
