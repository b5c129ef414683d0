"""Flies the scene with one fault and judges it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from follower.faults.injector import FaultInjector
from follower.faults.planned import PlannedFault
from follower.faults.scene import scene
from follower.faults.simulation import as_faults_want, verdicts
from follower.faults.stages import InjectedDeathError
from follower.faults.verdict import Verdict
from follower.flight_extras import FlightExtras
from follower.flying import fly_lockstep, fly_realtime
from follower.links.connection import open_connection
from follower.recorder import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder, epoch_now_ns
from follower.scenario_start import base_settings
from follower.settings import Settings, load_settings
from follower.simulated_flight import SimulatedFlight
from follower_control.transport import MemoryTransport, Transport
from follower_sim.world import World
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock


@dataclass(frozen=True, slots=True)
class Setup:
    """How a fault is flown.

    Attributes:
        flavour: "px4" or "ardupilot".
        link: "pymavlink" or "mavsdk".
        connection: what the follower opens in real time; None flies in lockstep.
    """

    flavour: str
    link: str = "pymavlink"
    connection: str | None = None


def fly_fault(planned: PlannedFault, setup: Setup, seed: int = 0) -> Verdict:
    """Fly the scene with one fault in it and return what came of it."""
    clock = SimulatedClock() if setup.connection is None else MonotonicClock()
    with ExitStack() as stack:
        ends = stack.enter_context(_ends(setup))
        wanted = as_faults_want([planned], _settings(setup), ends, clock)
        settings, ends = stack.enter_context(wanted)
        injector = FaultInjector([planned], clock, setup.flavour, seed, ends_flight=True)
        stack.enter_context(injector)
        recorder = None
        if planned.fault.needs_recorder:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            recorder = stack.enter_context(_recorder(settings, clock, folder))
        extras = FlightExtras(recorder=recorder, parts=injector)
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


def _settings(setup: Setup) -> Settings:
    return load_settings(base={**base_settings(scene()), "link": {"kind": setup.link}})


@contextmanager
def _ends(setup: Setup) -> Iterator[tuple[Transport, Transport]]:
    if setup.connection is None:
        yield MemoryTransport.pair()
        return
    from follower.simulate import other_end

    with (
        closing(open_connection(setup.connection)) as ours,
        closing(open_connection(other_end(setup.connection))) as theirs,
    ):
        yield ours, theirs


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
        epoch_ns=_epoch_ns(clock),
    )
    threaded = not isinstance(clock, SimulatedClock)
    return Recorder(folder, config, clock, settings.recorder, threaded)


def _epoch_ns(clock: Clock) -> int:
    return LOCKSTEP_EPOCH_NS if isinstance(clock, SimulatedClock) else epoch_now_ns(clock)
