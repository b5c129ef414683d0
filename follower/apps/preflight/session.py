"""`follower preflight`: the checklist, alone."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import typer
from rich.console import Console

from follower.apps.preflight.camera_checks import CameraWatch
from follower.apps.preflight.check import PreflightResult, Snapshot
from follower.apps.preflight.checklist import (
    checklist,
    live_checklist,
    parameters_for,
    print_checklist,
    run_checks,
    to_json,
)
from follower.apps.preflight.computer_checks import read_computer
from follower.apps.video_input import VideoInput
from follower.links.connections import open_connection
from follower.links.link import Link
from follower.links.open import open_link
from follower.recording import epoch_now_ns
from follower.settings.settings import Settings
from follower_control.vehicle.stale_data import StuckSensorDetector
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.detection.detectors import DETECTOR_PLUGINS, EMBEDDED
from follower_vision.models import ModelStore, default_folder
from follower_vision.onnx_network import path_of

_STEP_S = 0.02
_LEAST_S = 3.0
_SETTLED_S = 2.0
_WINDOW_S = 2.0
_JUDGE_EVERY_S = 0.25
_READY, _NOT_READY = 0, 1


@dataclass(frozen=True, slots=True)
class CheckScope:
    """What the checks need to know beside settings, link and camera.

    Attributes:
        skip: names of checks that do not refuse.
        folder: where the recording would go.
        lens_given: the settings name a field of view or a focal length.
        longest_s: how long to watch, in seconds, before a check counts as failed.
    """

    skip: frozenset[str]
    folder: Path
    lens_given: bool
    longest_s: float = 12.0


class LinkObserver:
    """Steps the link as a control loop would, sends no setpoint, and takes snapshots."""

    def __init__(
        self, link: Link, camera: CameraWatch, clock: Clock, settings: Settings, scope: CheckScope
    ) -> None:
        self._link = link
        self._camera = camera
        self._clock = clock
        self._settings = settings
        self._scope = scope
        self._liveness = StuckSensorDetector()
        self._ages_s: deque[tuple[float, float]] = deque()
        self._found_s: float | None = None
        self._models = model_states(settings)
        self._computer = read_computer(scope.folder)
        link.watch_health()

    def run(self, show: Callable[[list[PreflightResult]], None]) -> list[PreflightResult]:
        """Watch until nothing refuses any more, or for the scope's time; return the results.

        Args:
            show: is given what is known so far, some times a second.
        """
        start_s = judged_s = self._clock.now()
        while True:
            now_s = self._clock.now()
            self.step(now_s)
            if now_s - judged_s >= _JUDGE_EVERY_S:
                judged_s = now_s
                results = run_checks(self.snapshot(now_s), self._scope.skip)
                show(results)
                settled = now_s - start_s >= _LEAST_S and self._is_complete(now_s)
                refused = any(result.refuses for result in results)
                if (settled and not refused) or now_s - start_s >= self._scope.longest_s:
                    return results
            self._clock.sleep_until(now_s + _STEP_S)

    def step(self, now_s: float) -> None:
        """Take in what has come."""
        self._link.poll(now_s)
        for attitude in self._link.attitudes:
            self._liveness.note(attitude, now_s)
        if not self._link.connected:
            return
        if self._found_s is None:
            self._found_s = now_s
        if self._is_settled(now_s):
            self._ages_s.append((now_s, self._link.state.attitude_age_s(now_s)))
            while self._ages_s[0][0] < now_s - _WINDOW_S:
                self._ages_s.popleft()
        reader = self._link.parameters
        for names in parameters_for(self._link.autopilot_name):
            if not any(name in reader.values for name in names):
                reader.want(names)

    def snapshot(self, now_s: float) -> Snapshot:
        """Return all that is known now."""
        reader = self._link.parameters
        age_s = self._link.state.attitude_age_s(now_s)
        worst_s = max((age_s for _, age_s in self._ages_s), default=age_s)
        limit_s = self._settings.supervisor.telemetry_timeout_s
        return Snapshot(
            now_s=now_s,
            settings=self._settings,
            link=self._link.status(now_s),
            vehicle=self._link.state,
            health=self._link.health,
            attitude_age_s=max(age_s, worst_s),
            attitude_repeats=age_s < limit_s < self._liveness.age_s(now_s),
            parameters=dict(reader.values),
            camera=self._camera.reading(),
            models=self._models,
            lens_given=self._scope.lens_given,
            computer=self._computer,
        )

    def _is_complete(self, now_s: float) -> bool:
        """Whether everything that was asked for was reported, or asked for in vain."""
        reader = self._link.parameters
        if not self._is_settled(now_s) or self._link.health.firmware is None:
            return False
        known, missing = reader.values, reader.missing
        groups = parameters_for(self._link.autopilot_name)
        return all(known.keys() & set(names) or missing >= set(names) for names in groups)

    def _is_settled(self, now_s: float) -> bool:
        return self._found_s is not None and now_s - self._found_s >= _SETTLED_S


def model_states(settings: Settings) -> dict[str, str]:
    """Return the networks' files that the settings name: "good", "missing" or "wrong"."""
    store = ModelStore(default_folder())
    known = {model.name: model for model in store.models}
    states: dict[str, str] = {}
    for name in (settings.tracker, settings.detector, settings.fusion.model):
        if name in known:
            states |= {file: str(state) for file, state in store.verify(known[name]).items()}
        elif name is not None and name != settings.tracker and not _is_no_file(name):
            path = path_of(name)
            states[path.name] = "good" if path.is_file() else "missing"
    return states


def _is_no_file(detector: str) -> bool:
    return detector == EMBEDDED or DETECTOR_PLUGINS.find(detector) is not None


def preflight(
    settings: Settings,
    source: VideoInput,
    connect: str,
    scope: CheckScope,
    as_json: bool = False,
) -> int:
    """Check everything, show the list, and return the exit code: 0 only if nothing refuses.

    Args:
        settings: that would be flown with.
        source: the camera.
        connect: where the autopilot speaks MAVLink.
        scope: of the checks.
        as_json: write JSON instead of a table.

    Raises:
        ValueError, OSError: what the user can mend, in one line.
    """
    console = Console()
    clock = MonotonicClock()
    cv2.setNumThreads(1)
    with (
        opened_link(connect, settings, clock) as link,
        source.open_or_dead(clock) as frames,
        CameraWatch(frames, source.shown, clock) as camera,
        live_checklist(console) as live,
    ):
        observer = LinkObserver(link, camera, clock, settings, scope)
        results = observer.run(lambda found: live.update(checklist(found), refresh=True))
        snapshot = observer.snapshot(clock.now())
    if as_json:
        typer.echo(to_json(results, snapshot))
    else:
        print_checklist(console, results)
    return _NOT_READY if any(result.refuses for result in results) else _READY


@contextmanager
def opened_link(connect: str, settings: Settings, clock: Clock) -> Iterator[Link]:
    """Give a link to the autopilot that sends no setpoint by itself.

    Raises:
        ConnectionFailedError: it cannot be opened.
    """
    with (
        closing(open_connection(connect)) as transport,
        closing(open_link(transport, settings.link, clock, epoch_now_ns(clock))) as link,
    ):
        yield link
