"""One simulated flight: the world, the autopilot and the follower, wired together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from follower.autonomy import Autonomy, Phase
from follower.autopilot_wait import AutopilotWait
from follower.control_stage import ControlStage
from follower.flight_extras import FlightExtras
from follower.flight_parts import FlightParts
from follower.flight_truth import FlightTruth
from follower.flightlog import ControlRecord, FlightLog, TrackRecord
from follower.ground_station.flight_view import FlightView
from follower.links.link_settings import LinkSettings
from follower.links.link_status import LinkStatus
from follower.links.opening import open_link
from follower.live_status import LiveStatus
from follower.operator_requests import OperatorRequests
from follower.recorder import LOCKSTEP_EPOCH_NS, epoch_now_ns
from follower.scenario_start import gimbal_of, start_state
from follower.scoring import score_flight
from follower.selecting import colour_selector
from follower.settings import Settings
from follower.sight import Sight
from follower.situation import Order
from follower.supervisor import State
from follower.telemetry_vehicle import TelemetryVehicle
from follower.tracking import make_target_tracker
from follower.vision_stage import Selector, VisionStage
from follower_control.transport import Transport
from follower_sim.autopilot import SYSTEM_ID, SimAutopilot
from follower_sim.blind_camera import BlindCamera
from follower_sim.identity_score import IdentityScore
from follower_sim.kinematics import BodyState
from follower_sim.score import PursuitGoal, PursuitScore
from follower_sim.stand_in import StandIn
from follower_sim.truth_sample import TruthSample
from follower_sim.world import World
from follower_vision.box import Box
from follower_vision.clock import Clock, SimulatedClock
from follower_vision.frame import Frame
from follower_vision.fusion import BackgroundDetection, FusionTracker, InlineDetection
from follower_vision.lineofsight import LineOfSight

EXTERNAL = "external"
NO_EXTRAS = FlightExtras()
_STANDING_M_S = 0.3
_AIRBORNE_M = 2.0
_LONGEST_STOP_S = 6.0
_FAREWELL_S = 1.0
_STAND_IN = 21


class SimulatedFlight:
    """A drone with our follower in a simulated world.

    The scenario's time 0 is the clock's time 0; with an autopilot that runs elsewhere, and needs
    its own time to be ready and to be armed, it is when that is in the air, and the scenario's
    start is where it is then. Nothing of the truth goes to vision or control: they see frames and
    MAVLink.

    Args:
        world: what there is, its scenario and its seed.
        settings: of the follower.
        flavour: which autopilot to simulate, "px4" or "ardupilot", or "external" for one that
            runs elsewhere and is reached through the follower's transport.
        clock: stands at 0 now.
        ends: the transports of the follower and of the simulated autopilot.
        extras: who watches it, and what is unusual about it.

    Attributes:
        requests: where front ends put what their operators want.
    """

    def __init__(
        self,
        world: World,
        settings: Settings,
        flavour: str,
        clock: Clock,
        ends: tuple[Transport, Transport],
        extras: FlightExtras = NO_EXTRAS,
    ) -> None:
        self.scenario = scenario = world.scenario
        self._world = world
        self.settings = settings
        self._recorder = recorder = extras.recorder
        self._parts = parts = extras.parts or FlightParts()
        ours = parts.transport(ends[0])
        ours = ours if recorder is None else recorder.transport(ours)
        self._link = open_link(ours, _link_settings(settings, flavour), clock, _epoch_ns(clock))
        self.autopilot: SimAutopilot | None = None
        self.vehicle: SimAutopilot | TelemetryVehicle = TelemetryVehicle(
            self._link, start_state(scenario)
        )
        if flavour == EXTERNAL:
            world.begins_s = math.inf
        else:
            self.vehicle = self.autopilot = _autopilot(world, flavour, ends[1])
        self.sight = extras.sight
        is_blind = self.sight is Sight.TRUTH and extras.video is None
        self.camera = (BlindCamera if is_blind else parts.camera)(world, self._camera_at)
        self.log = FlightLog() if recorder is None else recorder.log
        self._wait = AutopilotWait(self._link, self.log)
        self._truth = FlightTruth(world, self.vehicle.state_at, self._camera_at)
        self.chosen_s: float | None = None
        self._operated = False
        self._ending = False
        self._stand_in = None if self.sight is Sight.PIXELS else self._make_stand_in()
        self._clock = clock
        self.requests = OperatorRequests(settings)
        mode = InlineDetection if isinstance(clock, SimulatedClock) else BackgroundDetection
        self._tracker = self._stand_in or make_target_tracker(settings, mode)
        self._vision_stage = VisionStage(self._tracker, self.requests, extras.finder)
        self.vision = parts.vision(
            self._vision_stage, clock, self.log, extras.video, self._lines, self._truth.compare
        )
        self._autonomy: Autonomy | None = None
        if settings.autonomy == "full":
            self._autonomy = Autonomy(self._link, scenario.takeoff_height_m)
        camera = scenario.camera.model
        self.stage = ControlStage(settings, camera, self.log, requests=self.requests)
        self._vision_stage.prospects = self.stage.prospect
        self.control = parts.control(
            self._link, self.stage, self._newest, self.log, self._autonomy, self._on_step, clock
        )
        parts.attach(self.autopilot, self.stop, partial(self.stage.order, Order.WITHDRAW))
        self._last_link: LinkStatus | None = None

    @property
    def phase(self) -> Phase | None:
        """How far the flight has come."""
        return None if self._autonomy is None else self._autonomy.phase

    @property
    def seed(self) -> int:
        """The seed of the world."""
        return self._world.seed

    @property
    def goal(self) -> PursuitGoal:
        """What the follower was asked to reach."""
        servo = self.settings.servo
        elevation = servo.elevation_deg
        wanted_deg = self.scenario.camera.pitch_deg if elevation is None else elevation
        distance = None if servo.mode == "watch" else servo.distance_m
        return PursuitGoal(distance, math.radians(wanted_deg))

    @property
    def view(self) -> FlightView:
        """What a ground station is told from."""
        camera = self.scenario.camera.model
        return FlightView(self.log, self._link, self.requests, (camera.width, camera.height))

    @property
    def truth(self) -> list[TruthSample]:
        """What really happened, a sample a control step."""
        return self._truth.samples

    def box_sight(self, sample: TruthSample) -> LineOfSight:
        """Work out the direction of the true box's middle from the heading, for one sample."""
        return self._truth.box_sight(sample)

    @property
    def overlaps(self) -> list[float]:
        """Intersection over union with the true box, one for each tracked frame."""
        return [frame.overlap for frame in self._truth.tracked]

    @property
    def identity(self) -> IdentityScore:
        """What has become of the target's identity."""
        return self._truth.identity

    def score(self) -> PursuitScore:
        """Score the flight, up to the operator's stop or to its end."""
        return score_flight(
            self.log,
            self.truth,
            self.goal,
            overlaps=self.overlaps,
            identity=self.identity,
            chosen_s=self.chosen_s,
        )

    def status(self) -> LiveStatus:
        """Return what a display shows of this moment."""
        errors, phase = self.stage.servo.errors, self._wait.words(self.phase)
        duration_s, link = self.scenario.duration_s, self.link_status.line()
        newest_s = self.log.controls[-1].time_s if self.log.controls else 0.0
        start_s = min(self._world.begins_s or 0.0, newest_s)
        return LiveStatus.of(self.log, start_s, duration_s, errors, phase, link)

    @property
    def link_status(self) -> LinkStatus:
        """How the link is, or how it was when it was closed."""
        return self._last_link or self._link.status(self._clock.now())

    def close(self) -> None:
        """Close the link, and with it the follower's transport, and end the tracker's threads."""
        self._last_link = self.link_status
        self._link.close()
        if isinstance(self._tracker, FusionTracker):
            self._tracker.close()
        self._parts.end()

    def operate(self) -> None:
        """Leave it to a person at a cockpit to choose the target and to begin again.

        No target is chosen then but by them, and letting go does not end the flight.
        """
        self._operated = True
        if self._autonomy is not None:
            self._autonomy.resumes = True

    def stop(self) -> None:
        """Let go, from any thread: hold, then release."""
        self._ending = True
        self.stage.request_stop()

    @property
    def finished(self) -> bool:
        """Whether the vehicle was let go and stands still, or has had time enough for it."""
        if self.stage.supervisor.state is not State.RELEASED:
            return False
        if self._operated and not self._ending:
            return False
        if not self._parts.is_over(self._clock.now()):
            return False
        waited_s = self.stage.supervisor.in_state_s(self._clock.now())
        speed = math.hypot(*self.vehicle.state.velocity_m_s)
        return waited_s > _LONGEST_STOP_S or (waited_s > _FAREWELL_S and speed < _STANDING_M_S)

    def _camera_at(self, time_s: float) -> BodyState:
        """Return the body that carries the camera: the vehicle's, or the gimbal's."""
        body = self.vehicle.state_at(time_s)
        gimbal = None if self.autopilot is None else self.autopilot.gimbal
        return body if gimbal is None else gimbal.camera(body)

    def _newest(self) -> TrackRecord | None:
        return self.vision.tracks.newest

    def _on_step(self, record: ControlRecord) -> None:
        """Take the truth beside each step, and play the operator."""
        now_s = record.time_s
        sample = self._truth.take(now_s)
        if self._recorder is not None:
            self._recorder.add_truth(sample)
        supervisor = self.stage.supervisor
        self._parts.observe(now_s, supervisor.state, supervisor.in_state_s(now_s))
        if self._world.begins_s == math.inf and self._is_airborne:
            self._begin(now_s)
        if self.chosen_s is None and self._may_be_chosen(record):
            self.chosen_s = now_s
            if not self._operated:
                self._vision_stage.select(self._selector())
        if self._world.scene_time(now_s) >= self.scenario.duration_s:
            self.stop()

    def _may_be_chosen(self, record: ControlRecord) -> bool:
        """Whether it is time to choose the target, or a person has chosen it."""
        if self._operated:
            return record.situation is not None and record.situation.target_chosen
        return self._is_airborne

    def _selector(self) -> Selector:
        """Return the way in which the operator points out the target."""
        select = self.scenario.select
        if self._stand_in is not None:
            return self._stand_in.select
        # A colour alone does not tell the target from its likes: the operator points at it.
        alike = self.scenario.lookalikes.count > 0
        return colour_selector(select.colour, select.search, self._pointed if alike else None)

    def _pointed(self, frame: Frame) -> Box | None:
        return self._truth.of_frame(frame.captured_s).box

    @property
    def _is_airborne(self) -> bool:
        """Whether the take-off is over, and with it the time to choose the target."""
        if self._autonomy is not None:
            return self._autonomy.phase is Phase.AIRBORNE
        vehicle = self._link.state
        high = vehicle.position is not None and vehicle.position.height_m > _AIRBORNE_M
        return vehicle.armed and vehicle.landed is not True and high

    def check_answered(self) -> None:
        """Refuse to wait for ever; looked at while a real-time flight goes on.

        Raises:
            ConnectionFailedError: no autopilot was heard, or it did not get into the air, for some
                time.
        """
        self._wait.check(self.phase, self._clock.now())

    def _begin(self, now_s: float) -> None:
        """Let the scenario begin, once an autopilot elsewhere is in the air."""
        if isinstance(self.vehicle, TelemetryVehicle):
            self.vehicle.place()
        self._world.begins_s = now_s

    def _make_stand_in(self) -> StandIn:
        camera, rng = self.scenario.camera, np.random.default_rng([self.seed, _STAND_IN])
        size = (camera.width, camera.height)
        return StandIn(self._truth.of_frame, size, self.scenario.stand_in, rng)

    def _lines(self) -> Sequence[str]:
        """Return what the video shows in its corner."""
        supervisor = self.stage.supervisor
        first = f"{self._clock.now():5.1f} s  {supervisor.state.upper()}  {supervisor.reason}"
        errors = self.stage.servo.errors
        if errors is None:
            return (first,)
        return first, (
            f"range {errors.range_m:4.1f} m  azimuth {math.degrees(errors.azimuth_rad):+5.1f}  "
            f"elevation {math.degrees(errors.elevation_rad):+5.1f} deg"
        )


def _link_settings(settings: Settings, flavour: str) -> LinkSettings:
    """Return the link's settings; which vehicle a simulated autopilot is, is known."""
    if flavour == EXTERNAL or settings.link.vehicle_id is not None:
        return settings.link
    return replace(settings.link, vehicle_id=SYSTEM_ID)


def _epoch_ns(clock: Clock) -> int:
    return LOCKSTEP_EPOCH_NS if isinstance(clock, SimulatedClock) else epoch_now_ns(clock)


def _autopilot(world: World, flavour: str, transport: Transport) -> SimAutopilot:
    scenario = world.scenario
    return SimAutopilot(
        flavour,
        transport,
        start_state(scenario),
        world.wind.velocity_m_s,
        gimbal=gimbal_of(scenario),
        drag=scenario.vehicle.drag,
    )
