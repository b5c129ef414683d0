"""One flight with a real autopilot and a real camera: the stages, wired together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from follower.apps.video_input import SteadySource
from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.control.takeoff_monitor import AutopilotWait
from follower.flight.log import ControlRecord, FlightLog, TrackRecord, noting_failed_plugins
from follower.flight.operator_requests import OperatorRequests
from follower.flight.status import LiveStatus
from follower.flight.supervision.autonomy import Autonomy
from follower.flight.supervision.flight_end import NO_FRAMES, FlightEnd
from follower.flight.supervision.release import is_resting
from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.flight.target.request import TargetFinder
from follower.flight.target.selectors import Selector
from follower.flight.threads import RealtimeRun, VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.video_sink import FlightVideo
from follower.links.link import Link
from follower.settings.settings import Settings
from follower.settings.supervisor import ReleaseAction
from follower_vision.clock import Clock
from follower_vision.mailbox import Mailbox
from follower_vision.trackers.target_tracker import TargetTracker

_TROUBLES = {
    SupervisorReason.LINK_SILENT: "the autopilot is silent: look after the link",
    SupervisorReason.TELEMETRY_STALE: "attitude or position do not come: look after the link",
    SupervisorReason.FRAMES_STALE: "no frames come: look after the camera",
    SupervisorReason.CONTROL_LATE: "this computer is too busy",
    SupervisorReason.TARGET_UNSEEN: "turn the camera towards the target",
    SupervisorReason.NOT_FLYING: "pilot: arm, take off, hover where the camera sees the target",
    SupervisorReason.NAVIGATION_POOR: "the autopilot does not know well where it is: wait",
    SupervisorReason.BATTERY_LOW: "the battery is too low to begin: land",
    SupervisorReason.COCKPIT_LOST: "no page is in control: open it, or take control there",
    SupervisorReason.AUTOPILOT_FAILSAFE: "the autopilot is in a failsafe",
}
_CONSENTS = {
    "command": "waiting for the operator's command",
    "rc": "waiting for the switch on the transmitter",
    "terminal": "press Enter to follow",
    "cockpit": "press Allow following on the page",
}
_MODES = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}


def waiting_for(
    record: ControlRecord | None,
    autopilot: str,
    target: str,
    settings: Settings,
    ending: bool = False,
) -> str:
    """Return what has to happen next, and who has to do it.

    Args:
        record: the newest control step, None before the first.
        autopilot: "px4", "ardupilot" or "unknown".
        target: in words.
        settings: of the flight.
        ending: the user has ended the flight.
    """
    if record is None or record.vehicle.heartbeat_s is None:
        return "waiting for the autopilot"
    mode = _MODES.get(autopilot, "OFFBOARD or GUIDED")
    if ending:
        still = record.vehicle.armed and record.vehicle.obeys_setpoints
        return f"ending; pilot: leave {mode} to take over" if still else "ending"
    if record.state is SupervisorState.IDLE:
        return f"looking for {target}"
    if record.state is SupervisorState.TRACKING:
        return _TROUBLES.get(record.reason, "")
    if record.state is SupervisorState.READY:
        if record.reason is SupervisorReason.WAITING_FOR_PILOT:
            return f"pilot: switch to {mode}, and it follows"
        return _CONSENTS.get(settings.consent.kind, "")
    if record.state is SupervisorState.RELEASED:
        return _after_release(record, mode, settings)
    return f"pilot: leave {mode} to take over"


def _after_release(record: ControlRecord, mode: str, settings: Settings) -> str:
    if record.vehicle.obeys_setpoints:
        return f"standing still: pilot, leave {mode} to take over"
    stopped = record.reason is SupervisorReason.STOP_REQUESTED
    withdrawn = record.situation is not None and not record.situation.consent_given
    by_mode = settings.consent.kind == "mode" and settings.consent.again == "mode"
    if by_mode and not (stopped or withdrawn):
        return f"yours; to follow again, fly a mode of your own and go back to {mode}"
    if settings.consent.takes_orders_by("terminal"):
        return "yours; consent (Enter, or on the page) to follow again, Ctrl-C ends"
    return f"yours; {_CONSENTS.get(settings.consent.kind, 'Ctrl-C ends')}"


_FAREWELL_S = 1.0
_LONGEST_STOP_S = 6.0
_STILL, _STILL_STEPS = 1e-6, 5
"""What is as good as zero in a setpoint, and how many such leave before the end."""
_SHOW_EVERY_S = 0.1


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
        size: width and height of the frames, in pixels.
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
        self.size = size
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
        self._selecting = threading.Lock()
        self._selector: Selector | None = None
        tracks = self.tracks
        self._control = ControlLoop(
            link, self.stage, lambda: tracks.newest, log, self._autonomy, clock=clock
        )

    @property
    def tracks(self) -> Mailbox[TrackRecord]:
        """Vision's newest answer; control reads it without taking it."""
        return self._vision.tracks

    def select(self, selector: Selector) -> None:
        """Follow what this finds in the coming frames; with full autonomy, once in the air.

        From any thread. ArduCopter takes off in GUIDED: a target chosen before would be followed
        from the ground on.
        """
        with self._selecting:
            self._selector = selector
        self._select_in_time()

    def _select_in_time(self) -> None:
        climbing = self._autonomy is not None and self._autonomy.phase.takes_off
        with self._selecting:
            if self._selector is not None and not climbing:
                self._vision_stage.select(self._selector)
                self._selector = None

    def run(self, watch: Callable[[RealFlight], None]) -> None:
        """Fly until `stop` and what follows on it; `watch` is called ten times a second."""

        def go_on() -> bool:
            watch(self)
            self._select_in_time()
            if self._ending or self._source.ended:
                self.stop(None if self._ending else NO_FRAMES)  # again: orders do not undo it
            return not self.finished

        rate_hz = self.settings.control_rate_hz
        run = RealtimeRun(self._clock, self._source, self._vision, self._control, rate_hz)
        with noting_failed_plugins(self.log, self._clock.now):
            run.run(go_on, _SHOW_EVERY_S)

    def stop(self, why: FlightEnd | None = None) -> None:
        """Hold, then release; from any thread. `why` is how the flight ends, if not as asked."""
        self._ending = True
        self.stage.request_stop(why)

    @property
    def end(self) -> FlightEnd:
        """How the flight has ended, if it ends now."""
        return self.stage.end

    @property
    def finished(self) -> bool:
        """Whether the vehicle was released, and stands still, is the pilot's or had its time.

        A control loop that hangs releases nobody: it is given the same time.
        """
        supervisor, vehicle = self.stage.supervisor, self._link.state
        if not self._ending:
            return False
        now_s = self._clock.now()
        if supervisor.state is not SupervisorState.RELEASED:
            stepped_s = self.log.controls[-1].time_s if self.log.controls else self._start_s
            return now_s - stepped_s > _LONGEST_STOP_S
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

    def status(self, target: str) -> LiveStatus:
        """Return what a display shows now; `target` is the target in words."""
        record = self.log.controls[-1] if self.log.controls else None
        words = waiting_for(record, self._link.autopilot_name, target, self.settings, self._ending)
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
