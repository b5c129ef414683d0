"""One simulated flight: the world, the autopilot and the follower, wired together."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from follower.flight.control.stage import ControlStage
from follower.flight.control.takeoff_monitor import AutopilotWait
from follower.flight.log import ControlRecord, FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.flight.status import LiveStatus
from follower.flight.supervision.autonomy import Autonomy, AutonomyPhase
from follower.flight.supervision.flight_end import FlightEnd
from follower.flight.supervision.inputs import ConsentRequest
from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.target.selectors import Selector, colour_selector
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import close_tracker, make_target_tracker
from follower.links.open import open_link
from follower.links.status import LinkStatus
from follower.recording import LOCKSTEP_EPOCH_NS, epoch_now_ns
from follower.settings.link import LinkSettings
from follower.settings.settings import Settings
from follower.simulation.components import FlightComponents, FlightOptions, gimbal_of, start_state
from follower.simulation.external_vehicle import TelemetryVehicle
from follower.simulation.ground_truth import FlightTruth, score_flight
from follower.simulation.options import EXTERNAL, VisionSource
from follower.ui.ground_station.flight_view import FlightView
from follower_control.common.transport import Transport
from follower_sim.autopilot.autopilot import SYSTEM_ID, SimAutopilot
from follower_sim.camera import BlindCamera
from follower_sim.kinematics import BodyState
from follower_sim.noisy_tracker import NoisyTracker
from follower_sim.scoring.score import PursuitGoal, PursuitScore
from follower_sim.world.world import World
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock
from follower_vision.fusion import BackgroundDetection, InlineDetection
from follower_vision.trackers.target_tracker import TargetTracker

NO_EXTRAS = FlightOptions()
_STANDING_M_S = 0.3
_AIRBORNE_M = 2.0
_LONGEST_STOP_S = 6.0
_LEAST_RELEASED_S = 1.0
_NOISE_STREAM = 21


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
        seed: the world's.
        lockstep: it is flown on a simulated clock.
        ground_truth: what really happened, and what tracks are worth beside it.
        truth: its samples, one a control step.
    """

    def __init__(
        self,
        world: World,
        settings: Settings,
        flavour: str,
        clock: Clock,
        ends: tuple[Transport, Transport],
        extras: FlightOptions = NO_EXTRAS,
    ) -> None:
        self.scenario = scenario = world.scenario
        self._world = world
        self.seed = world.seed
        self.settings = settings
        self.flavour = flavour
        self._recorder = recorder = extras.recorder
        self._parts = parts = extras.parts or FlightComponents()
        ours = parts.transport(ends[0])
        ours = ours if recorder is None else recorder.transport(ours)
        self._link = open_link(ours, _link_settings(settings, flavour), clock, epoch_ns(clock))
        self.autopilot: SimAutopilot | None = None
        self.vehicle: SimAutopilot | TelemetryVehicle = TelemetryVehicle(
            self._link, start_state(scenario)
        )
        if flavour == EXTERNAL:
            world.begins_s = math.inf
        else:
            self.vehicle = self.autopilot = SimAutopilot(
                flavour,
                ends[1],
                start_state(scenario),
                world.wind.velocity_m_s,
                gimbal=gimbal_of(scenario),
                drag=scenario.vehicle.drag,
            )
        self.vision_source = extras.vision
        is_blind = self.vision_source is VisionSource.TRUTH and extras.video is None
        self.camera = (BlindCamera if is_blind else parts.camera)(world, self._camera_at)
        self.log = FlightLog() if recorder is None else recorder.log
        self._wait = AutopilotWait(self._link, self.log, extras.boots_within_s)
        self.ground_truth = truth = FlightTruth(world, self.vehicle.state_at, self._camera_at)
        self.truth = truth.samples
        self.chosen_s: float | None = None
        self._operated = False
        self._ending = False
        self._noisy_tracker = (
            None if self.vision_source is VisionSource.PIXELS else self._make_noisy_tracker()
        )
        self._clock = clock
        self.lockstep = isinstance(clock, SimulatedClock)
        self.requests = OperatorRequests(settings)
        mode = InlineDetection if self.lockstep else BackgroundDetection
        self._tracker = self._noisy_tracker or make_target_tracker(settings, mode)
        self._vision_stage = VisionStage(self._tracker, self.requests, extras.finder)
        self.vision = parts.vision(
            self._vision_stage, clock, self.log, extras.video, self._lines, truth.compare
        )
        self._autonomy: Autonomy | None = None
        if settings.autonomy == "full":
            self._autonomy = Autonomy(self._link, scenario.takeoff_height_m)
        camera = scenario.camera.model
        self.stage = ControlStage(settings, camera, self.log, requests=self.requests)
        self._vision_stage.prospects = self.stage.prospect
        self.control = parts.control(
            self._link,
            self.stage,
            lambda: self.vision.tracks.newest,
            self.log,
            self._autonomy,
            self._on_step,
            clock,
        )
        parts.attach(self.autopilot, self.stop, partial(self.stage.order, ConsentRequest.WITHDRAW))
        self._last_link: LinkStatus | None = None

    @property
    def pace(self) -> str:
        """How its time passes, for people."""
        if not isinstance(self._clock, MonotonicClock):
            return "lockstep"
        speed = self._clock.speed
        return "real time" if speed == 1.0 else f"{speed:g} times real time"

    @property
    def phase(self) -> AutonomyPhase | None:
        """How far the flight has come."""
        return None if self._autonomy is None else self._autonomy.phase

    @property
    def goal(self) -> PursuitGoal:
        """What the follower was asked to reach."""
        servo = self.settings.servo
        elevation = servo.elevation_deg
        wanted_deg = self.scenario.camera.pitch_deg if elevation is None else elevation
        if servo.mode == "watch":
            return PursuitGoal(None, None)
        return PursuitGoal(servo.distance_m, math.radians(wanted_deg))

    @property
    def view(self) -> FlightView:
        """What a ground station takes its messages from."""
        camera = self.scenario.camera.model
        return FlightView(self.log, self._link, self.requests, (camera.width, camera.height))

    @property
    def tracker(self) -> TargetTracker:
        """What follows the target in the images."""
        return self._tracker

    def score(self) -> PursuitScore:
        """Score the flight, up to the stop, to the handing over or to its end."""
        return score_flight(
            self.log,
            self.truth,
            self.goal,
            overlaps=[frame.overlap for frame in self.ground_truth.tracked],
            identity=self.ground_truth.identity,
            chosen_s=self.chosen_s,
            box_sight=self.ground_truth.box_direction,
        )

    def status(self) -> LiveStatus:
        """Return what a display shows now."""
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
        close_tracker(self._tracker)
        self._parts.end()

    def operate(self) -> None:
        """Leave it to an operator at a cockpit to choose the target and to begin again.

        Only they choose a target then, and a release does not end the flight.
        """
        self._operated = True
        if self._autonomy is not None:
            self._autonomy.resumes = True

    def stop(self, why: FlightEnd | None = None) -> None:
        """Stop, from any thread: hold, then release; see `ControlStage.request_stop`."""
        self._ending = True
        self.stage.request_stop(why)

    @property
    def end(self) -> FlightEnd:
        """How the flight has ended, if it ends now."""
        return self.stage.end

    @property
    def finished(self) -> bool:
        """Whether the vehicle was released and stands still, or has had enough time for it."""
        if self.stage.supervisor.state is not SupervisorState.RELEASED:
            return False
        if self._operated and not self._ending:
            return False
        if not self._parts.is_over(self._clock.now()):
            return False
        waited_s = self.stage.supervisor.in_state_s(self._clock.now())
        speed = math.hypot(*self.vehicle.state.velocity_m_s)
        return waited_s > _LONGEST_STOP_S or (
            waited_s > _LEAST_RELEASED_S and speed < _STANDING_M_S
        )

    def _camera_at(self, time_s: float) -> BodyState:
        """Return the body that carries the camera: the vehicle's, or the gimbal's."""
        body = self.vehicle.state_at(time_s)
        gimbal = None if self.autopilot is None else self.autopilot.gimbal
        return body if gimbal is None else gimbal.camera(body)

    def _on_step(self, record: ControlRecord) -> None:
        """Take the truth beside each step, and play the operator."""
        now_s = record.time_s
        sample = self.ground_truth.take(now_s)
        if self._recorder is not None:
            self._recorder.add(sample, sample.time_s)
        supervisor = self.stage.supervisor
        self._parts.observe(now_s, supervisor.state, supervisor.in_state_s(now_s))
        if self._world.begins_s == math.inf and self._is_airborne:
            if isinstance(self.vehicle, TelemetryVehicle):
                self.vehicle.place()
            self._world.begins_s = now_s
        chosen = record.situation is not None and record.situation.target_chosen
        if self.chosen_s is None and (chosen if self._operated else self._is_airborne):
            self.chosen_s = now_s
            if not self._operated:
                self._vision_stage.select(self._selector())
        if self._world.scene_time(now_s) >= self.scenario.duration_s:
            self.stop()

    def _selector(self) -> Selector:
        """Return the way in which the operator points out the target."""
        select = self.scenario.select
        if self._noisy_tracker is not None:
            return self._noisy_tracker.select
        # A colour alone does not distinguish the target from lookalikes: the operator points.
        alike = self.scenario.lookalikes.count > 0
        true = self.ground_truth
        pointed = (lambda frame: true.of_frame(frame.captured_s).box) if alike else None
        return colour_selector(select.colour, select.search, pointed)

    @property
    def _is_airborne(self) -> bool:
        """Whether the take-off is over, and with it the time to choose the target."""
        if self._autonomy is not None:
            return self._autonomy.phase is AutonomyPhase.AIRBORNE
        vehicle = self._link.state
        high = vehicle.position is not None and vehicle.position.height_m > _AIRBORNE_M
        return vehicle.armed and vehicle.landed is not True and high

    def check_answered(self) -> None:
        """Refuse to wait for ever; called while a real-time flight goes on.

        Raises:
            ConnectionFailedError: no autopilot answered, or it did not get into the air, for some
                time.
        """
        self._wait.check(self.phase, self._clock.now())

    def _make_noisy_tracker(self) -> NoisyTracker:
        camera, rng = self.scenario.camera, np.random.default_rng([self.seed, _NOISE_STREAM])
        size = (camera.width, camera.height)
        return NoisyTracker(self.ground_truth.of_frame, size, self.scenario.stand_in, rng)

    def _lines(self) -> Sequence[str]:
        """Return what the video shows in its corner."""
        supervisor = self.stage.supervisor
        first = f"{self._clock.now():5.1f} s  {supervisor.state.upper()}  {supervisor.reason}"
        errors = self.stage.servo.errors
        if errors is None or not supervisor.state.steers:
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


def epoch_ns(clock: Clock) -> int:
    """Return the time of day, in ns since 1970, at which a flight's clock stands at 0."""
    return LOCKSTEP_EPOCH_NS if isinstance(clock, SimulatedClock) else epoch_now_ns(clock)
