"""Brings faults into a simulated flight at its seams."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self
from unittest.mock import patch

import numpy as np

from follower.faults.autopilot import AutopilotFaults
from follower.faults.camera import FaultyCamera
from follower.faults.evidence import Evidence, WireTap
from follower.faults.fault import Kind
from follower.faults.planned import PlannedFault
from follower.faults.schedule import FaultSchedule
from follower.faults.stages import FaultyControl, FaultyVision
from follower.faults.wire import FaultyTransport
from follower.flight_parts import FlightParts
from follower.recorder import append_file
from follower.supervisor import State
from follower_control.transport import Transport
from follower_sim.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_sim.world import World
from follower_vision.clock import Clock, SimulatedClock


class FaultInjector(FlightParts):
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
        self.evidence = Evidence(flavour)
        self._clock = clock
        self._flavour = flavour
        self._lots = np.random.default_rng([seed, 77])
        self._tap: WireTap | None = None
        self._vision: FaultyVision | None = None
        self._autopilot: AutopilotFaults | None = None
        self._stop: Callable[[], None] = lambda: None
        self._withdraw: Callable[[], None] = lambda: None
        self._stopped = self._signalled = False
        self._ends_flight = ends_flight
        self._patches = ExitStack()

    def __enter__(self) -> Self:
        write, now, now_ns = os.write, time.time, time.time_ns
        self._patches.enter_context(patch.object(append_file, "write_some", self._writes(write)))
        self._patches.enter_context(patch.object(time, "time", lambda: now() + self._ahead_s()))
        self._patches.enter_context(
            patch.object(time, "time_ns", lambda: now_ns() + int(1e9 * self._ahead_s()))
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._patches.close()

    @property
    def realtime(self) -> bool:
        """Whether the flight has threads and a clock that runs by itself."""
        return not isinstance(self._clock, SimulatedClock)

    def transport(self, inner: Transport) -> Transport:
        """Return the follower's transport with the faults in it and the watcher on it."""
        faulty = FaultyTransport(inner, self.schedule, self._clock, self._lots.spawn(1)[0])
        self._tap = WireTap(faulty, self._clock)
        return self._tap

    def camera(self, world: World, state_at: Callable[[float], BodyState]) -> FaultyCamera:
        """Return the camera with the faults in it."""
        return FaultyCamera(world, state_at, self.schedule)

    def vision(self, *arguments: Any) -> FaultyVision:
        """Return the vision loop with the faults in it; the arguments are `VisionLoop`'s."""
        stage, clock, *others = arguments
        self._vision = FaultyVision(self.schedule, clock, stage, *others)
        return self._vision

    def control(self, *arguments: Any) -> FaultyControl:
        """Return the control loop with the faults in it; the arguments are `ControlLoop`'s."""
        return FaultyControl(self.schedule, self._clock, self._lots.spawn(1)[0], *arguments)

    def attach(
        self,
        autopilot: SimAutopilot | None,
        stop: Callable[[], None],
        withdraw: Callable[[], None],
    ) -> None:
        """Take hold of the simulated autopilot, and of the operator's two ways to end it."""
        self._stop, self._withdraw = stop, withdraw
        if autopilot is None:
            return
        self._autopilot = AutopilotFaults(autopilot, self._flavour, self.schedule)

        def on_step(now_s: float) -> None:
            self._apply(now_s)
            self.evidence.watch(autopilot, now_s)

        autopilot.on_step = on_step

    def observe(self, now_s: float, state: State, in_state_s: float) -> None:
        """Look at a control step: faults begin by the supervisor's state."""
        self.schedule.observe(now_s, state, in_state_s)
        signalled = self.schedule.begun(Kind.PROCESS_SIGNALLED, now_s)
        if signalled is not None and not self._signalled:
            self._signalled = True
            os.kill(os.getpid(), int(signalled.amount))
        if self.schedule.active(Kind.CONSENT_WITHDRAWN, now_s) is not None:
            self._withdraw()
        asked = self.schedule.begun(Kind.STOP_REQUESTED, now_s) is not None
        if not self._stopped and (asked or (self._ends_flight and self.schedule.is_past(now_s))):
            self._stopped = True
            self._stop()

    def is_over(self, now_s: float) -> bool:
        """Whether the flight may end as far as the faults go."""
        return self.schedule.is_over(now_s)

    def end(self) -> None:
        """Let a hung thread go and read what the watcher noted."""
        if self._vision is not None:
            self._vision.ended = True
        if self._tap is not None:
            self.evidence.read(self._tap.sent, self._tap.heard)

    def _apply(self, now_s: float) -> None:
        if self._autopilot is not None:
            self._autopilot.apply(now_s)

    def _ahead_s(self) -> float:
        now_s = self._clock.now()
        action = self.schedule.active(Kind.WALL_CLOCK_JUMPS, now_s)
        if action is None:
            return 0.0
        return action.amount if int(now_s) % 2 else -action.amount

    def _writes(self, write: Callable[[int, Any], int]) -> Callable[[int, Any], int]:
        def write_some(descriptor: int, data: Any) -> int:
            if self.schedule.active(Kind.DISK_FULL, self._clock.now()) is not None:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return write(descriptor, data)

        return write_some
