"""One identification flight: in the simulator in lockstep, or by a link in real time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace

from follower.autonomy import Autonomy, Phase
from follower.control_loop import ControlLoop
from follower.excite.pattern import RUN_KEY, ExcitationSettings, Pattern
from follower.excite.stage import ExcitationStage
from follower.flightlog import FlightLog
from follower.links.link import Link
from follower.links.opening import open_link
from follower.lockstep import Lockstep
from follower.recorder import LOCKSTEP_EPOCH_NS, Recorder
from follower.settings import Settings
from follower.supervisor import State
from follower_control.transport import MemoryTransport
from follower_sim.autopilot import SYSTEM_ID, SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.vehicle import STEP_S, WindField
from follower_vision.camera import CameraModel
from follower_vision.clock import Clock, SimulatedClock

SIZE = (640, 480)
_STANDING_M_S, _FAREWELL_S, _LONGEST_STOP_S = 0.3, 1.0, 6.0
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
        self._control = ControlLoop(link, self.stage, _no_track, log, self._autonomy, clock=clock)

    @property
    def finished(self) -> bool:
        """Whether the vehicle was let go and stands, is the pilot's, or had its time."""
        supervisor, vehicle = self.stage.supervisor, self._link.state
        if supervisor.state is not State.RELEASED:
            return False
        waited_s = supervisor.in_state_s(self._clock.now())
        position = vehicle.position
        speed = math.inf
        if position is not None:
            speed = math.hypot(position.north_m_s, position.east_m_s, position.down_m_s)
        rests = speed < _STANDING_M_S or not vehicle.obeys_setpoints
        return waited_s > _LONGEST_STOP_S or (waited_s > _FAREWELL_S and rests)

    @property
    def complete(self) -> bool:
        """Whether all of the pattern was flown."""
        return self.stage.elapsed_s >= self.pattern.length_s

    def step(self, now_s: float, late_s: float = 0.0) -> None:
        """Do one control step."""
        airborne = self._autonomy is None or self._autonomy.phase is Phase.AIRBORNE
        self.stage.ready = self.stage.ready or airborne
        self._control.step(now_s, late_s)

    def run(self, watch: OnStep) -> None:
        """Fly in real time to the end; `watch` sees every step. The last word is a hold."""
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
    recorder: Recorder | None,
    clock: SimulatedClock,
    watch: OnStep,
    wind: WindField | None = None,
) -> ExcitationFlight:
    """Fly in lockstep against a simulated autopilot: the same each time."""
    ours, theirs = MemoryTransport.pair()
    transport = ours if recorder is None else recorder.transport(ours)
    who = replace(settings.link, vehicle_id=settings.link.vehicle_id or SYSTEM_ID)
    link = open_link(transport, who, clock, LOCKSTEP_EPOCH_NS)
    autopilot = SimAutopilot(flavour, theirs, BodyState(0.0, (0.0, 0.0, 0.0)), wind)
    log = FlightLog() if recorder is None else recorder.log
    flight = ExcitationFlight(settings, excitation, link, clock, log)
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


def _no_track() -> None:
    """Return what vision says: nothing."""
