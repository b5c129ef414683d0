"""Brings faults into a simulated flight at its seams."""

import errno
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, Self
from unittest.mock import patch

import numpy as np

from follower.flight.control.loop import ControlLoop
from follower.flight.log import TrackRecord
from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.threads import VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.recording import append_file
from follower.simulation.components import Action, FlightComponents
from follower.simulation.faults.fault import FaultKind, FaultSchedule, PlannedFault
from follower.simulation.faults.faulty_transport import FaultyTransport
from follower.simulation.faults.wire_tap import FIRMWARE, FlightEvidence, WireTap
from follower_control.common.transport import Transport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.camera import Delivery, Exposure, SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.world.world import World
from follower_vision.clock import Clock, SimulatedClock
from follower_vision.images.frame import Frame

_LOOK_S = 0.02
_STARVED_SHARE = 0.2


class InjectedDeathError(RuntimeError):
    """The vision thread was made to die."""


class FaultyVision(VisionLoop):
    """See `VisionLoop`; the further arguments are its own."""

    def __init__(
        self, schedule: FaultSchedule, stage: VisionStage, clock: Clock, *arguments: Any
    ) -> None:
        super().__init__(stage, clock, *arguments)
        self._schedule = schedule
        self._stands_still = isinstance(clock, SimulatedClock)
        self._busy_until_s = 0.0
        self.ended = False

    @property
    def is_free(self) -> bool:
        """Whether it takes a frame now, on a clock that stands still."""
        now_s = self._clock.now()
        dead = self._schedule.begun(FaultKind.VISION_DIES, now_s) is not None
        hung = self._schedule.active(FaultKind.VISION_HANGS, now_s) is not None
        return not dead and not hung and now_s >= self._busy_until_s

    def step(self, frame: Frame, delay_s: float = 0.0) -> TrackRecord:
        """Answer for one frame, late or never.

        Raises:
            InjectedDeathError: it is to die, in real time.
        """
        slow = self._schedule.active(FaultKind.VISION_SLOW, self._clock.now())
        if not self._stands_still:
            self._suffer(0.0 if slow is None else slow.amount)
        elif slow is not None:
            delay_s = slow.amount
        self._busy_until_s = self._clock.now() + delay_s
        return super().step(frame, delay_s)

    def _suffer(self, slow_s: float) -> None:
        if self._schedule.begun(FaultKind.VISION_DIES, self._clock.now()) is not None:
            raise InjectedDeathError("the vision thread was made to die")
        while not self.ended and self._schedule.active(FaultKind.VISION_HANGS, self._clock.now()):
            self._clock.sleep_until(self._clock.now() + _LOOK_S)
        self._clock.sleep_until(self._clock.now() + slow_s)


class FaultyControl(ControlLoop):
    """See `ControlLoop`; the further arguments are its own."""

    def __init__(
        self, schedule: FaultSchedule, clock: Clock, rng: np.random.Generator, *arguments: Any
    ) -> None:
        super().__init__(*arguments)
        self._schedule = schedule
        self._own_clock = clock
        self._rng = rng
        self._stands_still = isinstance(clock, SimulatedClock)
        self._paused_until_s = 0.0

    def step(self, now_s: float, late_s: float = 0.0) -> None:
        """Do one control step, due at `now_s` seconds, late or not at all."""
        self._pause(now_s)
        if self._stands_still and now_s < self._paused_until_s:
            return
        self._own_clock.sleep_until(self._paused_until_s)
        super().step(self._own_clock.now(), late_s)

    def _pause(self, now_s: float) -> None:
        if now_s < self._paused_until_s:
            return
        starved = self._schedule.active(FaultKind.CONTROL_STARVED, now_s)
        if starved is not None and self._rng.random() < _STARVED_SHARE:
            self._paused_until_s = now_s + float(self._rng.uniform(0.0, starved.amount))
        if self._schedule.active(FaultKind.CONTROL_STALLS, now_s) is not None:
            self._paused_until_s = self._schedule.end_of(FaultKind.CONTROL_STALLS, now_s)


PILOTS_MODE = {"px4": "POSCTL", "ardupilot": "LOITER"}
_FAILSAFE_MODE = "LAND"
_OTHERS = ("LOITER", "BRAKE", "RTL", "LAND")
_WELL, _BATTERY_PERCENT, _CENTRE_US = 0.1, 90.0, 1500.0


class AutopilotFaults:
    """Throws a simulated autopilot's switches.

    Args:
        autopilot: whose.
        flavour: "px4" or "ardupilot".
        schedule: says what is on.
    """

    def __init__(self, autopilot: SimAutopilot, flavour: str, schedule: FaultSchedule) -> None:
        self._autopilot = autopilot
        self._flavour = flavour
        self._schedule = schedule
        self._done = Counter[FaultKind]()
        self._before_s: float | None = None
        self._lost_s = 0.0

    def apply(self, now_s: float) -> None:
        """Set the autopilot's faults as they have to be at `now_s`, seconds."""
        faults = self._autopilot.faults
        faults.attitude_frozen = self._on(FaultKind.ATTITUDE_FROZEN, now_s)
        faults.position_frozen = self._on(FaultKind.POSITION_FROZEN, now_s)
        faults.telemetry_stopped = self._on(FaultKind.TELEMETRY_STOPPED, now_s)
        faults.attitude_nan = self._on(FaultKind.ATTITUDE_NAN, now_s)
        faults.position_nan = self._on(FaultKind.POSITION_NAN, now_s)
        faults.position_stopped = self._on(FaultKind.POSITION_STOPPED, now_s)
        faults.position_jump_m = self._amount(FaultKind.POSITION_JUMPS, now_s)
        faults.yaw_jump_rad = self._amount(FaultKind.YAW_JUMPS, now_s)
        faults.clock_jump_s = self._amount(FaultKind.CLOCK_JUMPS, now_s) - self._lost_time(now_s)
        faults.refuses_setpoints = self._on(FaultKind.MODE_REFUSED, now_s)
        faults.refused_modes = _OTHERS if self._on(FaultKind.OTHER_MODES_REFUSED, now_s) else ()
        self._autopilot.health.test_ratio = self._amount(FaultKind.ESTIMATOR_UNWELL, now_s, _WELL)
        self._autopilot.health.battery_percent = round(
            self._amount(FaultKind.BATTERY_LOW, now_s, _BATTERY_PERCENT)
        )
        if self._schedule.plans(FaultKind.STICK_MOVED):
            roll_us = round(self._amount(FaultKind.STICK_MOVED, now_s, _CENTRE_US))
            self._autopilot.move_sticks(roll_us, *(round(_CENTRE_US),) * 3)
        if self._begins(FaultKind.AUTOPILOT_RESTARTS, now_s):
            self._autopilot.restart()
        if self._begins(FaultKind.PILOT_SWITCHES, now_s):
            self._autopilot.switch_mode(PILOTS_MODE[self._flavour])
        if self._begins(FaultKind.PILOT_RETURNS, now_s):
            self._autopilot.switch_mode(FIRMWARE[self._flavour].setpoint_mode)
        if self._begins(FaultKind.ESTIMATOR_FAILSAFE, now_s):
            self._autopilot.switch_mode(_FAILSAFE_MODE)

    def _lost_time(self, now_s: float) -> float:
        """Return what the autopilot's clock has lost; it never makes up for it."""
        passed_s = 0.0 if self._before_s is None else now_s - self._before_s
        self._before_s = now_s
        self._lost_s += passed_s * self._amount(FaultKind.CLOCK_SLOW, now_s)
        return self._lost_s

    def _on(self, kind: FaultKind, now_s: float) -> bool:
        return self._schedule.active(kind, now_s) is not None

    def _amount(self, kind: FaultKind, now_s: float, otherwise: float = 0.0) -> float:
        action = self._schedule.active(kind, now_s)
        return otherwise if action is None else action.amount

    def _begins(self, kind: FaultKind, now_s: float) -> bool:
        before, self._done[kind] = self._done[kind], self._schedule.begins(kind, now_s)
        return self._done[kind] > before


class FaultyCamera(SimCamera):
    """See `SimCamera`."""

    def __init__(
        self, world: World, state_at: Callable[[float], BodyState], schedule: FaultSchedule
    ) -> None:
        super().__init__(world, state_at)
        self._schedule = schedule
        self._frozen: Exposure | None = None
        self._kept: Exposure | None = None
        self._is_odd = False

    def capture(self) -> Delivery | None:
        """Take the picture due, and do to it what the faults ask for."""
        now_s = self.next_capture_s
        delivery = super().capture()
        if delivery is None or self._schedule.active(FaultKind.FRAMES_SILENT, now_s) is not None:
            return None
        delivery = replace(delivery, exposure=self._spoiled(delivery.exposure, now_s))
        late = self._schedule.active(FaultKind.FRAMES_LATE, now_s)
        if late is not None:
            delivery = replace(delivery, available_s=delivery.available_s + late.amount)
        if self._schedule.active(FaultKind.FRAMES_REORDERED, now_s) is not None:
            return self._swapped(delivery)
        return delivery

    def _spoiled(self, exposure: Exposure, now_s: float) -> Exposure:
        if self._schedule.active(FaultKind.FRAMES_BLACK, now_s) is not None:
            return exposure.replaced(lambda: np.zeros_like(exposure.unseen.image))
        frozen = self._frozen
        if self._schedule.active(FaultKind.FRAMES_FROZEN, now_s) is None or frozen is None:
            self._frozen = exposure
            return exposure
        return exposure.replaced(lambda: frozen.frame.image)

    def _swapped(self, delivery: Delivery) -> Delivery | None:
        """Give the second of two frames before the first."""
        self._is_odd = not self._is_odd
        if not self._is_odd:
            return delivery
        before, self._kept = self._kept, delivery.exposure
        return None if before is None else replace(delivery, exposure=before)


class FaultInjector(FlightComponents):
    """Everything by which faults come into one flight, and an independent watcher beside it.

    Enter it around the flight: what is changed of the process is put back at the end.

    Args:
        planned: the faults.
        clock: the flight's.
        flavour: "px4" or "ardupilot".
        seed: of what is random in them.
        ends_flight: the flight is stopped some seconds after the last fault, not at its own end.
    """

    def __init__(
        self,
        planned: Iterable[PlannedFault],
        clock: Clock,
        flavour: str,
        seed: int = 0,
        ends_flight: bool = False,
    ) -> None:
        self.schedule = FaultSchedule(planned)
        self.evidence = FlightEvidence(flavour)
        self._clock = clock
        self._flavour = flavour
        self._rng = np.random.default_rng([seed, 77])
        self._tap: WireTap | None = None
        self._vision: FaultyVision | None = None
        self._stop: Action = lambda: None
        self._withdraw: Action = lambda: None
        self._stopped = self._signalled = False
        self._ends_flight = ends_flight
        self._patches = ExitStack()

    def __enter__(self) -> Self:
        now, now_ns = time.time, time.time_ns
        self._patches.enter_context(patch.object(append_file, "write_some", self._write_some))
        self._patches.enter_context(patch.object(time, "time", lambda: now() + self._ahead_s()))
        self._patches.enter_context(
            patch.object(time, "time_ns", lambda: now_ns() + int(1e9 * self._ahead_s()))
        )
        return self

    def __exit__(self, *_error: object) -> None:
        self._patches.close()

    @property
    def realtime(self) -> bool:
        """Whether the flight has threads and a clock that runs by itself."""
        return not isinstance(self._clock, SimulatedClock)

    def transport(self, inner: Transport) -> Transport:
        """Return the follower's transport with the faults in it and the watcher on it."""
        faulty = FaultyTransport(inner, self.schedule, self._clock, self._rng.spawn(1)[0])
        self._tap = WireTap(faulty, self._clock)
        return self._tap

    def camera(self, world: World, state_at: Callable[[float], BodyState]) -> FaultyCamera:
        """Return the camera with the faults in it."""
        return FaultyCamera(world, state_at, self.schedule)

    def vision(self, *arguments: Any) -> FaultyVision:
        """Return the vision loop with the faults in it; the arguments are `VisionLoop`'s."""
        self._vision = FaultyVision(self.schedule, *arguments)
        return self._vision

    def control(self, *arguments: Any) -> FaultyControl:
        """Return the control loop with the faults in it; the arguments are `ControlLoop`'s."""
        return FaultyControl(self.schedule, self._clock, self._rng.spawn(1)[0], *arguments)

    def attach(self, autopilot: SimAutopilot | None, stop: Action, withdraw: Action) -> None:
        """Keep the simulated autopilot, and the operator's two ways to end the flight."""
        self._stop, self._withdraw = stop, withdraw
        if autopilot is None:
            return
        faults = AutopilotFaults(autopilot, self._flavour, self.schedule)

        def on_step(now_s: float) -> None:
            faults.apply(now_s)
            self.evidence.watch(autopilot, now_s)

        autopilot.on_step = on_step

    def observe(self, now_s: float, state: SupervisorState, in_state_s: float) -> None:
        """Take the supervisor's state after a control step, by which faults begin; seconds."""
        self.schedule.observe(now_s, state, in_state_s)
        signalled = self.schedule.begun(FaultKind.PROCESS_SIGNALLED, now_s)
        if signalled is not None and not self._signalled:
            self._signalled = True
            os.kill(os.getpid(), int(signalled.amount))
        if self.schedule.active(FaultKind.CONSENT_WITHDRAWN, now_s) is not None:
            self._withdraw()
        asked = self.schedule.begun(FaultKind.STOP_REQUESTED, now_s) is not None
        if not self._stopped and (asked or (self._ends_flight and self.schedule.is_past(now_s))):
            self._stopped = True
            self._stop()

    def is_over(self, now_s: float) -> bool:
        """Whether the flight may end as far as the faults go."""
        return self.schedule.is_over(now_s)

    def end(self) -> None:
        """End a hung thread and read what the watcher noted."""
        if self._vision is not None:
            self._vision.ended = True
        if self._tap is not None:
            self.evidence.read(self._tap.sent, self._tap.received)

    def _ahead_s(self) -> float:
        now_s = self._clock.now()
        action = self.schedule.active(FaultKind.WALL_CLOCK_JUMPS, now_s)
        if action is None:
            return 0.0
        return action.amount if int(now_s) % 2 else -action.amount

    def _write_some(self, descriptor: int, data: Any) -> int:
        if self.schedule.active(FaultKind.DISK_FULL, self._clock.now()) is not None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return os.write(descriptor, data)
