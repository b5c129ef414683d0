"""A real flight between opening and closing: recorder, link and camera, the checks, the stages."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from follower.apps.fly.flight import RealFlight
from follower.apps.preflight.camera_checks import CameraWatch
from follower.apps.preflight.check import PreflightError, PreflightResult, Snapshot
from follower.apps.preflight.checklist import to_json
from follower.apps.preflight.session import CheckScope, LinkObserver
from follower.apps.target_choice import TargetChoice
from follower.apps.video_input import SteadySource, VideoInput
from follower.flight.target.request import TargetFinder
from follower.flight.target.selectors import check_in_image
from follower.flight.vision.video_sink import FlightVideo
from follower.links.link import Link
from follower.links.open import open_link
from follower.recording import FlightConfig, Recorder, epoch_now_ns
from follower.recording.config import late_detection
from follower.recording.run_folder import RunFiles
from follower.settings.settings import Settings
from follower.ui.ground_station.flight_view import FlightView
from follower.ui.ground_station.server import open_ground_station
from follower_control.common.transport import Transport
from follower_vision.clock import MonotonicClock
from follower_vision.disk import write_whole
from follower_vision.sources.frame_source import FrameSource
from follower_vision.trackers.target_tracker import TargetTracker

_KEPT = 3000
"""A minute of control steps stays in memory, for the display; the recording has them all."""
PREFLIGHT = "preflight.json"


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What is to be flown.

    Attributes:
        settings: to fly with.
        target: chosen before the flight, if it is.
        chooser: who chooses it otherwise, in words.
        camera: source of the frames.
        connect: where the autopilot speaks MAVLink.
        checks: before the flight.
        config: settings file into which changed settings are saved.
        command: the command line that flies it, "" if there is none.
        detector: whose detections are used in place of the settings' own, "" if nobody else's.
    """

    settings: Settings
    target: TargetChoice
    chooser: str
    camera: VideoInput
    connect: str
    checks: CheckScope
    config: Path | None = None
    command: str = ""
    detector: str = ""

    @property
    def shown_target(self) -> str:
        """The target in words."""
        return str(self.target) if self.target.given else f"what {self.chooser} selects"


class OpenedFlight:
    """Recorder, link and camera of a flight; `opened_flight` makes it.

    Attributes:
        plan: what is to be flown.
        link: to the autopilot.
        recorder: records.
        rate_hz: frames a second as the camera declares them, once it is ready.
    """

    def __init__(
        self,
        plan: FlightPlan,
        folder: Path,
        link: Link,
        recorder: Recorder,
        clock: MonotonicClock,
    ) -> None:
        self.plan = plan
        self.link = link
        self.recorder = recorder
        self._folder = folder
        self._clock = clock
        self._source: FrameSource = plan.camera.open_or_dead(clock)
        self.rate_hz = 0.0
        self._size = (0, 0)
        self._checked: tuple[list[PreflightResult], Snapshot] | None = None

    def close(self) -> None:
        """Close the camera."""
        self._source.close()

    def check(self, show: Callable[[list[PreflightResult]], None]) -> list[PreflightResult]:
        """Run the preflight checks and return their results.

        Args:
            show: is given what is known so far, some times a second.
        """
        plan, clock = self.plan, self._clock
        with CameraWatch(self._source, plan.camera.shown, clock) as camera:
            observer = LinkObserver(self.link, camera, clock, plan.settings, plan.checks)
            results = observer.run(show)
            self._checked = results, observer.snapshot(clock.now())
        return results

    def ready(
        self,
        tracker: TargetTracker,
        finder: TargetFinder | None = None,
        video: FlightVideo | None = None,
    ) -> RealFlight:
        """Return the flight, wired; it has not begun.

        Args:
            tracker: fresh.
            finder: finds what operators point at.
            video: is shown every frame, if given.

        Raises:
            PreflightError: there was no check, or one refuses the flight.
            SourceError: less than half of the target lies in the image.
        """
        results, snapshot = self._checked or ([], None)
        size = None if snapshot is None else snapshot.camera.size
        if snapshot is None or size is None or any(result.refuses for result in results):
            raise PreflightError(results)
        for box in self.plan.target.boxes:
            check_in_image(box, *size)
        said = to_json(results, snapshot) + "\n"
        RunFiles(self._folder).write(PREFLIGHT, lambda path: write_whole(path, said))
        self._source = self.plan.camera.restarted(self._source, self._clock)
        steady, self._size = SteadySource(self._source, size), size
        self.rate_hz = steady.nominal_rate_hz
        log, settings = self.recorder.log, self.plan.settings
        return RealFlight(
            settings, steady, size, self.link, tracker, self._clock, log, finder, video
        )

    def ground_station(self, flight: RealFlight) -> AbstractContextManager[None]:
        """Return what answers ground stations while entered, if the settings want it."""
        view = FlightView(self.recorder.log, self.link, flight.requests, self._size)
        save = partial(flight.requests.save, self.plan.config)
        return open_ground_station(self.plan.settings, view, self.rate_hz, self._clock, save)


@contextmanager
def opened_flight(
    plan: FlightPlan, folder: Path, transport: Transport, clock: MonotonicClock
) -> Iterator[OpenedFlight]:
    """Open recorder, link and camera; close them when the flight is over.

    Raises:
        ValueError, OSError: what the user can mend, in one line.
    """
    settings, epoch_ns = plan.settings, epoch_now_ns(clock)
    run = {
        "source": plan.camera.shown,
        "connect": plan.connect,
        "target": plan.shown_target,
        "detection": late_detection(settings),
        **({"detector": plan.detector} if plan.detector else {}),
        "command": plan.command,
    }
    config = FlightConfig.of("real", settings, run=run, epoch_ns=epoch_ns)
    with ExitStack() as stack:
        recorder = Recorder(folder, config, clock, settings.recorder, kept=_KEPT)
        stack.enter_context(recorder)
        link = open_link(recorder.transport(transport), settings.link, clock, epoch_ns)
        stack.enter_context(closing(link))
        opened = OpenedFlight(plan, folder, link, recorder, clock)
        yield stack.enter_context(closing(opened))
