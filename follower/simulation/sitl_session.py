"""One flight against an autopilot's program: started, watched, told of gusts, and judged."""

from dataclasses import replace
from pathlib import Path

from follower.flight.supervision.autonomy import AutonomyPhase
from follower.flight.supervision.flight_end import AUTOPILOT_ENDED, FlightEnd
from follower.links.connections import ConnectionFailedError
from follower.simulation.faults.setpoint_rules import envelope_failures, heartbeat_failures
from follower.simulation.faults.wire_tap import FlightEvidence, WireTap
from follower.simulation.flight import SimulatedFlight
from follower.simulation.sitl.gusts import Gusts
from follower.simulation.sitl.process import BOOTS_WITHIN_S, AutopilotProcess
from follower.simulation.sitl.programs import SitlProgram, SitlSetup
from follower_control.common.transport import Transport
from follower_sim.autopilot.autopilot import SYSTEM_ID
from follower_sim.world.world import World
from follower_vision.clock import Clock
from follower_vision.sources.frame_source import ClosesItself

_LEAST_PACE = 0.97


class SitlSession(ClosesItself):
    """A program that runs until it is closed, and what it does to a flight.

    Args:
        program: what is started; `listen` was called.
        setup: how it is started.
        world: the scenario's; what it needs of the program's parameters is set.
        folder: exists already; gets the program's output and its own log.
        transport: goes to the program.
        clock: the flight's.

    Attributes:
        transport: for the follower, in place of the one given: what passes is kept.
        death: how the flight ended, if that was because the program ended by itself.

    Raises:
        ConnectionFailedError: it cannot be started.
    """

    def __init__(
        self,
        program: SitlProgram,
        setup: SitlSetup,
        world: World,
        folder: Path,
        transport: Transport,
        clock: Clock,
    ) -> None:
        self._program = program
        self._setup = setup
        self._scenario = world.scenario
        parameters = program.for_scenario(world.scenario, setup.parameters)
        self._process = AutopilotProcess(program, replace(setup, parameters=parameters), folder)
        self._gusts: Gusts | None = None
        if world.scenario.wind.gust_m_s:
            self._gusts = Gusts(program, setup.parameters, world, transport, clock)
        self.transport = WireTap(transport, clock)
        self.death: FlightEnd | None = None

    @property
    def boots_within_s(self) -> float:
        """How long it may take until it speaks, by its own clock."""
        return BOOTS_WITHIN_S * self._setup.speedup

    def step(self, flight: SimulatedFlight) -> None:
        """Stop a flight whose program has ended; tell one that is in the air of the wind.

        Raises:
            ConnectionFailedError: it ended before it flew.
        """
        if self._process.death and self.death is None:
            if flight.phase in (AutonomyPhase.CONNECTING, AutonomyPhase.ARMING):
                raise ConnectionFailedError(f"{self._process.death} before it flew")
            sentence = AUTOPILOT_ENDED.sentence.format(held=self._said(self._process.death))
            self.death = replace(AUTOPILOT_ENDED, sentence=sentence)
            flight.stop(self.death)
        if self._gusts is not None and flight.chosen_s is not None:
            self._gusts.step(flight.link_status.vehicle_id)

    def explained(self, error: ConnectionFailedError) -> ConnectionFailedError:
        """Return the error with what the program wrote at the end."""
        return ConnectionFailedError(self._said(str(error)))

    def remarks(self) -> tuple[str, ...]:
        """Return what is to be said of the program; "" of what is as usual."""
        return self._program.remark, self._program.lacks(self._scenario)

    def too_slow(self, flight: SimulatedFlight) -> str | None:
        """Return a remark on a program that fell behind its time, None if it did not."""
        pace, asked = flight.link_status.clock_pace, self._setup.speedup
        if pace is None or pace >= _LEAST_PACE:
            return None
        return (
            f"{self._program.title} ran at {pace * asked:.2f} times real time, "
            f"{asked:g} were asked for: this computer is too slow or too busy for it; "
            "figures of time and speed are off by as much. Take a lower --speedup."
        )

    def violations(self, flight: SimulatedFlight) -> tuple[str, ...]:
        """Return what an independent watcher of the wire saw against the rules."""
        evidence = FlightEvidence(self._program.flavour)
        vehicle_id = flight.link_status.vehicle_id or SYSTEM_ID
        evidence.read(self.transport.sent, self.transport.received, vehicle_id)
        limits = flight.settings.envelope
        outside = envelope_failures(evidence.setpoints, limits, limits.max_interval_s)
        return (*outside, *heartbeat_failures(evidence))

    def close(self) -> None:
        """End the program, and keep its log."""
        self._process.close()

    def _said(self, what: str) -> str:
        return f"{what}; its output ends: {self._process.last_lines}"
