"""`follower excite`: fly the pattern, and print what to do with the recording."""

import shlex
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from follower.flight.control.loop import ControlLoop
from follower.flight.lockstep import Lockstep
from follower.flight.log import FlightLog
from follower.flight.supervision.autonomy import Autonomy, AutonomyPhase
from follower.flight.supervision.flight_end import FAILED, NOT_RECORDED, SUCCESS
from follower.flight.supervision.release import is_resting
from follower.flight.supervision.supervisor import SupervisorState
from follower.links.connections import open_connection
from follower.links.link import Link
from follower.links.open import open_link
from follower.recording import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder, epoch_now_ns
from follower.recording.run_folder import new_run_folder
from follower.settings.settings import Settings, load_settings
from follower.settings.supervisor import ConsentSettings
from follower.tuning.excite.pattern import RUN_KEY, ExcitationSettings, Pattern
from follower.tuning.excite.stage import ExcitationStage, excitation_settings
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import StopOnInterrupt
from follower_control.common.transport import MemoryTransport
from follower_sim.autopilot.autopilot import SYSTEM_ID, SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import WindSettings
from follower_sim.vehicle.vehicle import STEP_S, WindField
from follower_sim.world.wind import Wind
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock
from follower_vision.geometry.camera_model import CameraModel

SIZE = (640, 480)
_FAREWELL_S, _LONGEST_STOP_S = 1.0, 6.0
_GIVE_UP_S = 120.0
OnStep = Callable[["ExcitationFlight"], None]


class ExcitationFlight:
    """The stage, its loop and, where the settings ask for it, the played pilot.

    Args:
        settings: those of `excitation_settings`.
        excitation: what to fly.
        link: to the autopilot.
        clock: the system's.
        log: takes everything.
    """

    def __init__(
        self,
        settings: Settings,
        excitation: ExcitationSettings,
        link: Link,
        clock: Clock,
        log: FlightLog,
    ) -> None:
        self.pattern = Pattern(excitation)
        self.log = log
        self._link, self._clock = link, clock
        self._period_s = 1 / settings.control_rate_hz
        self.stage = ExcitationStage(settings, self.pattern, camera_of(settings), log)
        self._autonomy: Autonomy | None = None
        if settings.autonomy == "full":
            self._autonomy = Autonomy(link, settings.takeoff_height_m)
        self._control = ControlLoop(
            link, self.stage, lambda: None, log, self._autonomy, clock=clock
        )

    @property
    def finished(self) -> bool:
        """Whether the vehicle was released and stands, is the pilot's, or had its time."""
        supervisor, vehicle = self.stage.supervisor, self._link.state
        if supervisor.state is not SupervisorState.RELEASED:
            return False
        now_s = self._clock.now()
        waited_s = supervisor.in_state_s(now_s)
        rests = is_resting(vehicle, now_s) or not vehicle.obeys_setpoints
        return waited_s > _LONGEST_STOP_S or (waited_s > _FAREWELL_S and rests)

    @property
    def complete(self) -> bool:
        """Whether all of the pattern was flown."""
        return self.stage.elapsed_s >= self.pattern.length_s

    def step(self, now_s: float, late_s: float = 0.0) -> None:
        """Do one control step at `now_s`, seconds, which was due `late_s` before."""
        airborne = self._autonomy is None or self._autonomy.phase is AutonomyPhase.AIRBORNE
        self.stage.ready = self.stage.ready or airborne
        self._control.step(now_s, late_s)

    def run(self, watch: OnStep) -> None:
        """Fly in real time to the end; `watch` sees every step. The last setpoint is a hold."""
        due_s = self._clock.now()
        try:
            while not self.finished:
                self._clock.sleep_until(due_s)
                now_s = self._clock.now()
                self.step(now_s, now_s - due_s)
                watch(self)
                missed = max(0.0, self._clock.now() - due_s) // self._period_s
                due_s += (1 + missed) * self._period_s
        finally:
            self._control.hold()


def fly_simulated(
    flavour: str,
    settings: Settings,
    excitation: ExcitationSettings,
    recorder: Recorder,
    clock: SimulatedClock,
    watch: OnStep,
    wind: WindField | None = None,
) -> ExcitationFlight:
    """Fly in lockstep against a simulated autopilot: the same each time."""
    ours, theirs = MemoryTransport.pair()
    who = replace(settings.link, vehicle_id=settings.link.vehicle_id or SYSTEM_ID)
    link = open_link(recorder.transport(ours), who, clock, LOCKSTEP_EPOCH_NS)
    autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, 0.0)), wind)
    flight = ExcitationFlight(settings, excitation, link, clock, recorder.log)
    lockstep = Lockstep(clock)

    def control() -> None:
        flight.step(clock.now())
        watch(flight)

    lockstep.every(STEP_S, lambda: autopilot.step(clock.now()))
    lockstep.every(1 / settings.control_rate_hz, control)
    longest_s = flight.pattern.length_s + _GIVE_UP_S
    lockstep.run(lambda: flight.finished or clock.now() > longest_s)
    link.close()
    return flight


def camera_of(settings: Settings) -> CameraModel:
    """Return a camera that sees nothing, for the recording."""
    return settings.camera.model(*SIZE)


def run_of(excitation: ExcitationSettings) -> dict[str, object]:
    """Return the pattern for a recording's `run`."""
    plain = {key: getattr(value, "value", value) for key, value in asdict(excitation).items()}
    return {RUN_KEY: plain}


FLAVOURS = ("px4", "ardupilot")


@dataclass(frozen=True, slots=True)
class ExcitationRun:
    """What is flown, with what, and where its recording goes.

    Attributes:
        excitation: the pattern's settings.
        connect: where a real autopilot speaks MAVLink; None simulates one.
        autopilot: the simulated one, "px4" or "ardupilot".
        out: folder in which the run gets its own.
        wind_m_s: mean of the simulated wind.
        seed: of its gusts.
        command: the command line.
    """

    excitation: ExcitationSettings
    connect: str | None
    autopilot: str
    out: Path
    wind_m_s: float
    seed: int
    command: str


def excite(run: ExcitationRun, config: Path | None, overrides: Sequence[str]) -> int:
    """Fly the pattern; return 0 if all of it was flown, 1 if it was asked to end early.

    If it was released early, return the flight end's exit code.

    Raises:
        SettingsError, ConnectionFailedError: what the user can mend, in one line.
    """
    settings = excitation_settings(load_settings(config, overrides=overrides))
    if run.connect is None:  # on a simulated clock nobody else can be pilot or operator
        alone = {"autonomy": "full", "consent": ConsentSettings()}
        settings = settings.model_copy(update=alone)
    console = Console()
    length_s = Pattern(run.excitation).length_s
    words = TextColumn("{task.description}", markup=False)
    with (
        StopOnInterrupt() as keyboard,
        Progress(words, BarColumn(), TimeRemainingColumn(), console=console) as progress,
    ):
        task = progress.add_task("Waiting for the vehicle", total=length_s)

        def watch(flight: ExcitationFlight) -> None:
            if keyboard.interrupted:
                flight.stage.request_stop()
            supervisor = flight.stage.supervisor
            text = f"{supervisor.state}: {supervisor.reason}"
            progress.update(task, completed=flight.stage.elapsed_s, description=text)

        if run.connect is None:
            folder, flight, recorder = _simulated(run, settings, watch)
        else:
            folder, flight, recorder = _real(run, settings, run.connect, watch)
    end = flight.stage.end
    for remark in recorder.remarks:
        print_line(console, remark)
    if flight.complete:
        print_line(console, f"All of the pattern was flown: {folder}")
    else:
        print_line(
            console,
            f"{end.sentence} after {flight.stage.elapsed_s:.0f} of "
            f"{flight.pattern.length_s:.0f} s: {folder}",
        )
    if flight.stage.elapsed_s > 0:
        print_line(console, f"Next: follower identify {shlex.quote(str(folder))}")
    return SUCCESS if flight.complete else end.exit_code or FAILED


def _config(run: ExcitationRun, settings: Settings, kind: str, epoch_ns: int) -> FlightConfig:
    recorded = {
        **run_of(run.excitation),
        "autopilot": run.connect or run.autopilot,
        "seed": run.seed,
        "command": run.command,
    }
    camera = camera_of(settings)
    return FlightConfig.of(kind, settings, run=recorded, camera=camera, epoch_ns=epoch_ns)


def _simulated(
    run: ExcitationRun, settings: Settings, watch: OnStep
) -> tuple[Path, ExcitationFlight, Recorder]:
    clock = SimulatedClock()
    folder = new_run_folder(run.out, "excite")
    config = _config(run, settings, "simulated", LOCKSTEP_EPOCH_NS)
    gusts = WindSettings(mean_m_s=run.wind_m_s, from_deg=40.0, gust_m_s=0.2 * run.wind_m_s)
    wind = Wind(gusts, np.random.default_rng(run.seed)).velocity_m_s if run.wind_m_s else None
    with Recorder(folder, config, clock, settings.recorder, threaded=False) as recorder:
        flight = fly_simulated(
            run.autopilot, settings, run.excitation, recorder, clock, _with(recorder, watch), wind
        )
    return folder, flight, recorder


def _real(
    run: ExcitationRun, settings: Settings, connect: str, watch: OnStep
) -> tuple[Path, ExcitationFlight, Recorder]:
    clock = MonotonicClock()
    epoch_ns = epoch_now_ns(clock)
    with ExitStack() as stack:
        transport = open_connection(connect)
        stack.callback(transport.close)
        folder = new_run_folder(run.out, "excite")
        config = _config(run, settings, "real", epoch_ns)
        recorder = stack.enter_context(Recorder(folder, config, clock, settings.recorder))
        wrapped = recorder.transport(transport)
        link = stack.enter_context(closing(open_link(wrapped, settings.link, clock, epoch_ns)))
        flight = ExcitationFlight(settings, run.excitation, link, clock, recorder.log)
        flight.run(_with(recorder, watch))
    return folder, flight, recorder


def _with(recorder: Recorder, watch: OnStep) -> OnStep:
    """Return what watches each step, and asks to stop if the recorder must."""

    def step(flight: ExcitationFlight) -> None:
        if recorder.must_stop:
            flight.stage.request_stop(NOT_RECORDED)
        watch(flight)

    return step
