"""One flight with a real autopilot and a real camera: the stages, wired together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from follower.autonomy import Autonomy, Phase
from follower.autopilot_wait import AutopilotWait
from follower.control_loop import ControlLoop
from follower.control_stage import ControlStage
from follower.flight_video import FlightVideo
from follower.flightlog import FlightLog, TrackRecord
from follower.fly.camera import SteadySource
from follower.fly.waiting import waiting_for
from follower.links.link import Link
from follower.live_status import LiveStatus
from follower.operator_requests import OperatorRequests
from follower.realtime import RealtimeRun, VisionLoop
from follower.release import ReleaseAction, is_resting
from follower.settings import Settings
from follower.supervisor import State
from follower.target_finder import TargetFinder
from follower.vision_stage import Selector, VisionStage
from follower_vision.clock import Clock
from follower_vision.target_tracker import TargetTracker

_FAREWELL_S = 1.0
_LONGEST_STOP_S = 6.0
_STILL, _STILL_STEPS = 1e-6, 5
"""What is as good as zero in a setpoint, and how many such leave before the end."""
_SHOW_EVERY_S = 0.1


RunWatch: TypeAlias = Callable[["RealFlight"], None]
"""Looks at a flight while it goes on."""


class RealFlight:
    """Vision and control between a camera and a link that are open already.

    Args:
        settings: of the flight.
        source: the camera.
        size: width and height of its frames.
        link: to the autopilot.
        tracker: fresh.
        clock: the system's.
        log: takes everything.
        finder: finds what operators point at.
        video: is shown every frame, if given.

    Attributes:
        requests: where front ends put what their operators want.
    """

    def __init__(
        self,
        settings: Settings,
        source: SteadySource,
        size: tuple[int, int],
        link: Link,
        tracker: TargetTracker,
        clock: Clock,
        log: FlightLog,
        finder: TargetFinder | None = None,
        video: FlightVideo | None = None,
    ) -> None:
        self.settings = settings
        self.log = log
        self._source = source
        self._link = link
        self._clock = clock
        self._start_s = clock.now()
        self._ending = False
        self.requests = OperatorRequests(settings)
        self._vision_stage = VisionStage(tracker, self.requests, finder)
        self._vision = VisionLoop(self._vision_stage, clock, log, video, self._lines)
        camera = settings.camera.model(*size)
        self.stage = ControlStage(settings, camera, log, requests=self.requests)
        self._vision_stage.prospects = self.stage.prospect
        self._autonomy: Autonomy | None = None
        if settings.autonomy == "full":
            self._autonomy = Autonomy(link, settings.takeoff_height_m)
        self._wait = AutopilotWait(link, log)
        self._selector: Selector | None = None
        self._control = ControlLoop(
            link, self.stage, self._newest, log, self._autonomy, clock=clock
        )

    def select(self, selector: Selector) -> None:
        """Follow what this finds in the coming frames; with full autonomy, once in the air.

        ArduCopter takes off in GUIDED: a target chosen before would be followed from the ground on.
        """
        self._selector = selector
        self._select_in_time()

    def _select_in_time(self) -> None:
        climbing = self._autonomy is not None and self._autonomy.phase is not Phase.AIRBORNE
        if self._selector is not None and not climbing:
            self._vision_stage.select(self._selector)
            self._selector = None

    def run(self, watch: RunWatch) -> None:
        """Fly until `stop` and what follows on it; `watch` is called ten times a second."""

        def go_on() -> bool:
            watch(self)
            self._select_in_time()
            if self._ending or self._source.ended:
                self.stop()  # again: an order that came meanwhile does not undo it
            return not self.finished

        rate_hz = self.settings.control_rate_hz
        run = RealtimeRun(self._clock, self._source, self._vision, self._control, rate_hz)
        run.run(go_on, _SHOW_EVERY_S)

    def stop(self) -> None:
        """Let go, from any thread: hold, then release."""
        self._ending = True
        self.stage.request_stop()

    @property
    def finished(self) -> bool:
        """Whether the vehicle was let go, and stands still, is the pilot's or had its time."""
        supervisor, vehicle = self.stage.supervisor, self._link.state
        if not self._ending or supervisor.state is not State.RELEASED:
            return False
        now_s = self._clock.now()
        waited_s = supervisor.in_state_s(now_s)
        if not (vehicle.obeys_setpoints and vehicle.armed):
            return waited_s > _FAREWELL_S
        changes_mode = self.settings.release.action not in (
            ReleaseAction.HOLD,
            ReleaseAction.HAND_BACK,
        )
        rests = is_resting(vehicle, now_s) and self._asks_for_rest and not changes_mode
        return waited_s > _LONGEST_STOP_S or (waited_s > _FAREWELL_S and rests)

    @property
    def _asks_for_rest(self) -> bool:
        """Whether the last setpoints are zeros: an autopilot may fly the very last one on."""
        last = self.log.controls[-_STILL_STEPS:]
        return all(abs(value) < _STILL for record in last for value in record.allowed.values)

    def status(self, wish: str) -> LiveStatus:
        """Return what a display shows of this moment; `wish` is the target in words."""
        record = self.log.controls[-1] if self.log.controls else None
        words = waiting_for(record, self._link.autopilot_name, wish, self.settings, self._ending)
        if self._autonomy is not None and self._selector is not None:
            words = self._wait.words(self._autonomy.phase)
        if self._source.problem:
            words = f"{words} (camera: {self._source.problem})"
        link = self._link.status(self._clock.now()).line()
        errors = self.stage.servo.errors
        return LiveStatus.of(self.log, self._start_s, None, errors, words, link)

    def _lines(self) -> Sequence[str]:
        """Return what a video shows in its corner."""
        supervisor = self.stage.supervisor
        return (f"{supervisor.state.upper()}  {supervisor.reason}",)

    def _newest(self) -> TrackRecord | None:
        return self._vision.tracks.newest
