"""One random flight, from a seed: drawn, flown, watched."""

import cmath
import math
from dataclasses import dataclass, field

import numpy as np

from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorState
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.link import LinkSettings
from follower.settings.settings import Settings, load_settings
from follower.simulation.fault_tests.invariants import InputAges, InvariantError, Invariants
from follower.simulation.fault_tests.random_faults import (
    Distortion,
    RandomFaultSchedule,
    RandomTracks,
)
from follower.simulation.fault_tests.simple_vehicle import SimpleVehicle, WireWatch
from follower.simulation.faults.fault import FaultKind
from follower.simulation.faults.faulty_transport import FaultyTransport
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.state import VehicleState
from follower_vision.clock import SimulatedClock

STEP_S = 0.02
_CALM_S = 3.0
_CLOSING_S = 10.0
_STOPS_WITHIN_S = 3.0
"""How long a vehicle that was in a mode of its own may take to stand in ours."""
_STANDING_M_S = 0.5
_PITCH_DEG = -20.0
_PILOT = {"leaves": 0.02, "returns": 0.2, "stops": 0.003, "renews": 0.4, "disarms": 0.001}
"""How often the pilot and the operator act, 1/s."""


@dataclass(slots=True)
class FlightResult:
    """What came of one random flight.

    Attributes:
        steps: of control.
        engaged_steps: of them, with setpoints by which the vehicle flies.
        setpoints: that went over the wire.
        failure: what was not as it must be, "" if all was.
        after_pilot_s: longest time from a heartbeat of another mode to the last setpoint, seconds.
        faults: how often each kind began.
        states: how many steps each state had.
    """

    steps: int = 0
    engaged_steps: int = 0
    setpoints: int = 0
    failure: str = ""
    after_pilot_s: float = 0.0
    faults: dict[str, int] = field(default_factory=dict)
    states: dict[str, int] = field(default_factory=dict)


def fly_random(seed: tuple[int, int]) -> FlightResult:
    """Draw a flight from a seed, fly it, and return what came of it."""
    return _RandomFlight(seed).fly()


class _RandomFlight:
    """One flight with its pilot and its operator."""

    def __init__(self, seed: tuple[int, int]) -> None:
        self._result = FlightResult()
        rng, vehicle_rng, schedule_rng, tracks_rng, wire_rng = np.random.default_rng(seed).spawn(5)
        self._rng = rng
        self._flavour = str(rng.choice(["px4", "ardupilot"]))
        self._settings = _random_settings(rng)
        self._clock = SimulatedClock()
        self._schedule = RandomFaultSchedule(
            schedule_rng, _CALM_S, float(rng.choice([0.3, 1.0, 3.0]))
        )
        ours, theirs = MemoryTransport.pair()
        start = (0.0, 0.0, -float(rng.uniform(4.0, 30.0)))
        self._vehicle = SimpleVehicle(self._flavour, theirs, vehicle_rng, start)
        self._vehicle.distort = Distortion(self._schedule)
        faulty = FaultyTransport(ours, self._schedule, self._clock, wire_rng)
        self._watch = WireWatch(faulty)
        link = MavlinkLink(self._watch, LinkSettings(vehicle_id=1))
        camera = self._settings.camera.model(640, 480)
        bearing = self._vehicle.yaw_rad + float(rng.uniform(-0.4, 0.4))
        away = float(rng.uniform(6.0, 40.0))
        target = (away * math.cos(bearing), away * math.sin(bearing))
        pitch = math.radians(_PITCH_DEG)
        self._tracks = RandomTracks(camera, pitch, self._schedule, tracks_rng, target)
        self._stage = ControlStage(self._settings, camera, FlightLog(kept=1))
        self._loop = ControlLoop(
            link, self._stage, lambda: self._tracks.newest, FlightLog(), None, self._note
        )
        firmware = self._vehicle.firmware
        own = firmware.modes[firmware.setpoint_mode].custom_mode
        by_mode = self._settings.consent.again == "mode"
        self._invariants = Invariants(self._settings, own, by_mode)
        self._record: ControlRecord | None = None

    def fly(self) -> FlightResult:
        """Fly to the end."""
        result, duration_s = self._result, float(self._rng.uniform(15.0, 60.0))
        try:
            self._until(duration_s)
            self._stage.request_stop()
            self._until(duration_s + _CLOSING_S, closing=True)
            self._at_rest()
        except InvariantError as error:
            result.failure = f"{self._clock.now():.2f} s: {error}"
        except Exception as error:
            result.failure = f"{self._clock.now():.2f} s: {type(error).__name__}: {error}"
        result.setpoints = self._invariants.setpoints
        result.after_pilot_s = self._invariants.longest_after_pilot_s
        result.faults = self._schedule.counts
        return result

    def _until(self, end_s: float, closing: bool = False) -> None:
        while self._clock.now() < end_s:
            interval_s = self._interval()
            now_s = self._clock.now() + interval_s
            self._clock.sleep_until(now_s)
            self._schedule.step(now_s)
            if not closing:
                self._act(interval_s)
            self._fly_vehicle(now_s, interval_s)
            self._tracks.step(now_s, interval_s, self._vehicle)
            self._control(now_s, interval_s)

    def _interval(self) -> float:
        """Return the time to the next control step: 20 ms, or what is left of the computer."""
        now_s = self._clock.now()
        stalled = self._schedule.active(FaultKind.CONTROL_STALLS, now_s)
        if stalled is not None:
            return max(STEP_S, self._schedule.end_of(FaultKind.CONTROL_STALLS, now_s) - now_s)
        starved = self._schedule.active(FaultKind.CONTROL_STARVED, now_s)
        late_s = 0.0 if starved is None else float(self._rng.uniform(0.0, starved.amount))
        return STEP_S + late_s

    def _fly_vehicle(self, now_s: float, interval_s: float) -> None:
        """Step the vehicle; in a long pause of ours it flies on by itself."""
        before_s = now_s - interval_s
        parts = max(1, round(interval_s / STEP_S))
        for part in range(1, parts + 1):
            self._vehicle.step(before_s + interval_s * part / parts, interval_s / parts)

    def _control(self, now_s: float, interval_s: float) -> None:
        self._watch.now_s = now_s
        before = self._stage.supervisor.state
        self._loop.step(now_s)
        engages = self._stage.supervisor.state.engaged and not before.engaged
        for mode in self._watch.modes:
            self._invariants.heartbeat(mode, now_s)
        if self._record is not None:
            record, newest = self._record, self._tracks.newest
            inputs = InputAges(
                math.inf if newest is None else now_s - newest.captured_s,
                now_s - self._tracks.shows_s,
                self._invariants.heartbeat_age_s(now_s),
                interval_s,
                max(record.vehicle.attitude_age_s(now_s), record.vehicle.position_age_s(now_s)),
                _own_velocity(record.vehicle),
                record.state.steers,
                record.allowed.values,
            )
            self._invariants.check(self._watch.setpoints, now_s, inputs, engages)
        self._watch.setpoints, self._watch.modes = [], []

    def _note(self, record: ControlRecord) -> None:
        result = self._result
        self._record = record
        result.steps += 1
        result.engaged_steps += record.state.engaged
        result.states[record.state.value] = result.states.get(record.state.value, 0) + 1

    def _act(self, interval_s: float) -> None:
        """Let the pilot and the operator do what they do."""
        does = {name: self._rng.random() < rate * interval_s for name, rate in _PILOT.items()}
        vehicle, firmware = self._vehicle, self._vehicle.firmware
        if does["leaves"] and vehicle.obeys:
            vehicle.enter(str(self._rng.choice(["RTL", "LAND", firmware.hold_mode])))
        ready = self._record is not None and self._record.state is SupervisorState.READY
        if (does["returns"] or ready) and not vehicle.obeys:
            vehicle.enter(firmware.setpoint_mode)
        if does["stops"]:
            self._stage.request_stop()
        if (
            does["renews"]
            and self._record is not None
            and self._record.state is SupervisorState.RELEASED
        ):
            self._stage.order(ConsentRequest.RENEW)
            self._invariants.consent()
        if does["disarms"]:
            vehicle.landed = not vehicle.landed
        vehicle.refuses = bool(self._rng.random() < 0.001) or (
            vehicle.refuses and self._rng.random() < 0.99
        )

    def _at_rest(self) -> None:
        vehicle = self._vehicle
        ours_s = self._clock.now() - vehicle.obeys_since_s
        if vehicle.obeys and ours_s > _STOPS_WITHIN_S and vehicle.speed_m_s > _STANDING_M_S:
            raise InvariantError(
                f"at the end it flies on at {vehicle.speed_m_s:.1f} m/s, with nobody in control"
            )


def _own_velocity(vehicle: VehicleState) -> complex | None:
    """Return forward and right velocity by telemetry, m/s, None without it."""
    if vehicle.position is None or vehicle.attitude is None:
        return None
    north_east = complex(vehicle.position.north_m_s, vehicle.position.east_m_s)
    return north_east * cmath.rect(1.0, -vehicle.attitude.yaw_rad)


def _random_settings(rng: np.random.Generator) -> Settings:
    """Return settings drawn from what somebody might choose."""
    return load_settings(
        base={
            "camera": {"pitch_deg": _PITCH_DEG},
            "envelope": {
                "max_speed_m_s": float(rng.uniform(2.0, 15.0)),
                "max_acceleration_m_s2": float(rng.uniform(2.0, 5.0)),
                "max_jerk_m_s3": float(rng.uniform(5.0, 30.0)),
                "max_yaw_acceleration_deg_s2": float(rng.uniform(60.0, 300.0)),
                "max_yaw_jerk_deg_s3": float(rng.uniform(400.0, 3000.0)),
                "min_distance_m": float(rng.uniform(2.0, 6.0)),
                "fence_radius_m": float(rng.choice([40.0, 200.0])),
            },
            "servo": {
                "distance_m": float(rng.uniform(8.0, 25.0)),
                "target_size_m": 2.0,
                "mode": str(rng.choice(["chase", "chase", "watch"])),
            },
            "supervisor": {
                "search_s": float(rng.uniform(1.0, 10.0)),
                "hold_s": float(rng.uniform(0.5, 5.0)),
            },
            "consent": {"again": str(rng.choice(["operator", "operator", "mode"]))},
        }
    )
