"""Looks at link and camera for some seconds, until there is enough for the checks."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from follower.links.link import Link
from follower.preflight.camera_watch import CameraWatch
from follower.preflight.check import Result
from follower.preflight.computer import read_computer
from follower.preflight.running import parameters_for, run_checks
from follower.preflight.snapshot import AttitudeReading, Snapshot
from follower.settings import Settings
from follower_control.liveness import Liveness
from follower_vision.clock import Clock
from follower_vision.models import ModelStore, default_folder

_STEP_S = 0.02
_LEAST_S = 3.0
_SETTLED_S = 2.0
_WINDOW_S = 2.0
_JUDGE_EVERY_S = 0.25


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the checks need to know beside link and camera.

    Attributes:
        settings: that would be flown with.
        folder: where the recording would go.
        lens_given: the settings name a field of view or a focal length.
    """

    settings: Settings
    folder: Path
    lens_given: bool


class Observation:
    """Steps the link as a control loop would, sends no setpoint, and takes snapshots.

    Args:
        link: to the autopilot.
        camera: is being watched.
        clock: the system's.
        about: see there.
    """

    def __init__(self, link: Link, camera: CameraWatch, clock: Clock, about: Surroundings) -> None:
        self._link = link
        self._camera = camera
        self._clock = clock
        self._about = about
        self._liveness = Liveness()
        self._ages_s: deque[tuple[float, float]] = deque()
        self._found_s: float | None = None
        self._models = model_states(about.settings)
        self._computer = read_computer(about.folder)
        link.watch_health()

    def run(
        self,
        skip: frozenset[str],
        show: Callable[[list[Result]], None],
        longest_s: float,
    ) -> list[Result]:
        """Look until nothing refuses any more, or for `longest_s`; return what came out.

        Args:
            skip: checks that do not refuse.
            show: is given what is known so far, some times a second.
            longest_s: of looking.
        """
        start_s = judged_s = self._clock.now()
        while True:
            now_s = self._clock.now()
            self.step(now_s)
            if now_s - judged_s >= _JUDGE_EVERY_S:
                judged_s = now_s
                results = run_checks(self.snapshot(now_s), skip)
                show(results)
                settled = now_s - start_s >= _LEAST_S and self._is_complete(now_s)
                refused = any(result.refuses for result in results)
                if (settled and not refused) or now_s - start_s >= longest_s:
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
        known = () if self._link.parameters is None else self._link.parameters.values
        for names in parameters_for(self._link.autopilot_name):
            if not any(name in known for name in names):
                self._link.read_parameters(names)

    def snapshot(self, now_s: float) -> Snapshot:
        """Return all that is known now."""
        reader = self._link.parameters
        return Snapshot(
            now_s=now_s,
            settings=self._about.settings,
            link=self._link.status(now_s),
            vehicle=self._link.state,
            health=self._link.health,
            attitude=self._attitude(now_s),
            parameters={} if reader is None else reader.values,
            missing_parameters=frozenset() if reader is None else reader.missing,
            camera=self._camera.reading(),
            models=self._models,
            lens_given=self._about.lens_given,
            computer=self._computer,
        )

    def _attitude(self, now_s: float) -> AttitudeReading:
        age_s = self._link.state.attitude_age_s(now_s)
        limit_s = self._about.settings.supervisor.telemetry_timeout_s
        repeats = age_s < limit_s < self._liveness.age_s(now_s)
        worst_s = max((age_s for _, age_s in self._ages_s), default=age_s)
        return AttitudeReading(max(age_s, worst_s), repeats)

    def _is_complete(self, now_s: float) -> bool:
        """Whether everything that was asked for was told, or asked for in vain."""
        reader = self._link.parameters
        if reader is None or not self._is_settled(now_s) or self._link.health.firmware is None:
            return False
        known, missing = reader.values, reader.missing
        groups = parameters_for(self._link.autopilot_name)
        return all(known.keys() & set(names) or missing >= set(names) for names in groups)

    def _is_settled(self, now_s: float) -> bool:
        return self._found_s is not None and now_s - self._found_s >= _SETTLED_S


def model_states(settings: Settings) -> dict[str, str]:
    """Return the networks' files that the settings name: "good", "missing" or "wrong"."""
    store = ModelStore(default_folder(os.environ))
    known = {model.name: model for model in store.models}
    states: dict[str, str] = {}
    for name in (settings.tracker, settings.detector, settings.appearance):
        if name in known:
            states |= {file: str(state) for file, state in store.verify(known[name]).items()}
        elif name is not None and name != settings.tracker:
            states[Path(name).name] = "good" if Path(name).is_file() else "missing"
    return states
