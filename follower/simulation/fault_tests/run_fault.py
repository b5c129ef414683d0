"""Flies the scene with one fault and judges it."""

import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from follower.recording import FlightConfig, Recorder
from follower.settings.settings import Settings, load_settings
from follower.simulation.components import FlightOptions, start_state
from follower.simulation.faults.fault import Fault, FaultSetup, PlannedFault
from follower.simulation.faults.in_simulation import as_faults_want, verdicts
from follower.simulation.faults.injector import FaultInjector, InjectedDeathError
from follower.simulation.faults.judge import FaultVerdict, judge_seen
from follower.simulation.faults.wire_tap import FlightEvidence, WireTap
from follower.simulation.flight import SimulatedFlight, epoch_ns
from follower.simulation.runners import fly_lockstep, fly_realtime
from follower_control.common.transport import MemoryTransport, UdpTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import base_settings, load_scenario
from follower_sim.vehicle.vehicle import STEP_S
from follower_sim.world.world import World
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock

_PATIENCE_S = 60.0
_FAST_M_S, _STEADY_S = 2.0, 3.0
_AFTERWARDS_S = 12.0
_START = "from follower.apps.main import main; main()"

SCENE = Path(__file__).with_name("scene.yaml")


def scene() -> Scenario:
    """Return the scenario."""
    return load_scenario(SCENE)


def fly_fault(fault: Fault, setup: FaultSetup) -> FaultVerdict:
    """Fly the scene with one fault in it and return what came of it."""
    if fault.signal is not None:
        return fly_process(fault, setup)
    planned = PlannedFault.of(fault)
    clock = MonotonicClock() if setup.realtime else SimulatedClock()
    with ExitStack() as stack:
        ours, theirs = UdpTransport.pair() if setup.realtime else MemoryTransport.pair()
        stack.enter_context(closing(ours))
        stack.enter_context(closing(theirs))
        settings = load_settings(base={**base_settings(scene()), "link": {"kind": setup.link}})
        wanted = as_faults_want([planned], settings, (ours, theirs), clock)
        settings, ends = stack.enter_context(wanted)
        injector = FaultInjector([planned], clock, setup.flavour, ends_flight=True)
        stack.enter_context(injector)
        recorder = None
        if fault.needs_recorder:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            recorder = stack.enter_context(_recorder(settings, clock, folder))
        extras = FlightOptions(recorder=recorder, parts=injector)
        flight = SimulatedFlight(_world(), settings, setup.flavour, clock, ends, extras)
        error = _fly(flight, clock)
    return verdicts([planned], flight, injector, error)[0]


def _fly(flight: SimulatedFlight, clock: Clock) -> str:
    """Fly to the end; return what was raised, "" if nothing but what was meant to be."""
    fly: Callable[..., None] = fly_lockstep if isinstance(clock, SimulatedClock) else fly_realtime
    with closing(flight):
        try:
            fly(flight, clock, lambda: None)
        except InjectedDeathError:
            return ""
        except Exception as error:
            return f"{type(error).__name__}: {error}"
    return ""


@cache
def _world() -> World:
    """Return the world, which is the same in all flights; painting it takes a while."""
    return World(scene(), None)


def _recorder(settings: Settings, clock: Clock, folder: Path) -> Recorder:
    config = FlightConfig.of(
        "simulated",
        settings,
        run={"scenario": "fault"},
        camera=scene().camera.model,
        epoch_ns=epoch_ns(clock),
    )
    return Recorder(folder, config, clock, settings.recorder, not isinstance(clock, SimulatedClock))


@dataclass(slots=True)
class _Flight:
    """What was seen of one process."""

    evidence: FlightEvidence
    from_s: float = math.inf
    code: int | None = None
    ended_s: float = math.inf
    output: str = ""


def fly_process(fault: Fault, setup: FaultSetup) -> FaultVerdict:
    """Fly the scene with the follower in another process, signal it, and judge what comes of it.

    Args:
        fault: one with a signal.
        setup: which autopilot and link; it flies in real time.
    """
    # The process calls: so the autopilot's port is any free one.
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(UdpTransport.listen("127.0.0.1", 0)) as theirs,
    ):
        command = _command(Path(folder), setup.link, f"udpout:127.0.0.1:{theirs.port}")
        clock = MonotonicClock()
        tap = WireTap(theirs, clock)
        autopilot = SimAutopilot(setup.flavour, tap, start_state(scene()))
        flight = _Flight(FlightEvidence(setup.flavour))
        process = subprocess.Popen(  # noqa: S603  ourselves
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        try:
            _watch(process, autopilot, clock, fault, flight)
        finally:
            process.kill()
            flight.output = process.communicate()[0]
        flight.evidence.read(tap.received, tap.sent)
    return _judged(fault, flight)


def _command(folder: Path, link: str, connection: str) -> list[str]:
    where = ["--out", str(folder), "--connect", connection]
    how = ["--autopilot", "external", "--link", link, "--no-video", "--no-record"]
    return [sys.executable, "-c", _START, "sim", str(SCENE), *where, *how]


def _watch(
    process: subprocess.Popen[str],
    autopilot: SimAutopilot,
    clock: MonotonicClock,
    fault: Fault,
    flight: _Flight,
) -> None:
    """Be the autopilot until some time after the signal."""
    fast_since_s = math.inf
    while not _is_over(flight, clock.now()):
        now_s = clock.now()
        autopilot.step(now_s)
        flight.evidence.watch(autopilot, now_s)
        motion = flight.evidence.motion[-1]
        moves = motion.speed_m_s > _FAST_M_S and motion.obeys
        fast_since_s = min(fast_since_s, now_s) if moves else math.inf
        if flight.from_s == math.inf and now_s - fast_since_s > _STEADY_S:
            flight.from_s = now_s
            os.kill(process.pid, fault.signal or signal.SIGKILL)
        if flight.code is None:
            flight.code = process.poll()
            flight.ended_s = now_s if flight.code is not None else math.inf
        clock.sleep_until(now_s + STEP_S)


def _is_over(flight: _Flight, now_s: float) -> bool:
    """Whether there is nothing more to see: the report at the process's end takes its time."""
    if flight.from_s == math.inf:
        return now_s > _PATIENCE_S
    since_s = now_s - flight.from_s
    return since_s > (_PATIENCE_S if flight.code is None else _AFTERWARDS_S)


def _judged(fault: Fault, flight: _Flight) -> FaultVerdict:
    verdict = judge_seen(fault, flight.evidence, flight.from_s)
    failures = tuple(_failures(flight, verdict))
    ended = f"ended with {flight.code} after {flight.ended_s - flight.from_s:.1f} s"
    return replace(verdict, failures=failures, end=ended)


def _failures(flight: _Flight, verdict: FaultVerdict) -> Iterator[str]:
    if flight.from_s == math.inf:
        yield f"it never flew fast enough to be signalled; its output: {flight.output[-300:]}"
        return
    yield from verdict.failures
    if flight.code is None:
        yield "the process did not end"
    if "Traceback" in flight.output:
        yield f"an uncaught error: {flight.output[-300:]}"
