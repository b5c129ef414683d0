"""Tracks and telemetry in, setpoints out: one step of the control loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from follower.flightlog import ControlRecord, FlightLog, Observation, TrackRecord
from follower.health import judge
from follower.human_input import HumanInput
from follower.links.vehicle_health import VehicleHealth
from follower.release import HandBack
from follower.settings import Settings
from follower.stopwatch import Stopwatch
from follower.supervisor import Order, Situation, State, Supervisor
from follower_control.attitude_history import AttitudeHistory
from follower_control.coasting import slowed
from follower_control.envelope import Envelope, LimitedSetpoint
from follower_control.estimate import TargetEstimate
from follower_control.estimate_trust import trust_in
from follower_control.estimator import TargetEstimator
from follower_control.flight_context import FlightContext
from follower_control.gimbal import GimbalRates
from follower_control.gimbal_history import GimbalHistory
from follower_control.gimbal_servo import GimbalServo
from follower_control.ground_range import range_to_ground
from follower_control.liveness import Liveness, PositionLiveness
from follower_control.search import Search
from follower_control.servo import VisualServo
from follower_control.servo_settings import Mode
from follower_control.setpoint import HOLD, VelocitySetpoint
from follower_control.sighter import Sighter
from follower_control.sound_telemetry import SoundTelemetry
from follower_control.vehicle import Attitude, VehicleState
from follower_vision.camera import CameraModel
from follower_vision.track import Track, TrackState

_NEEDS_STREAM = "OFFBOARD"
_GOOD_DIRECTION_RAD = math.radians(5.0)
"""Standard deviation of the predicted direction beyond which nobody should steer by it."""


class ControlStage:
    """Estimator, supervisor, servo and envelope behind one `step`; no I/O, threads or clock.

    The caller polls the link, hands in what it and vision say, and sends what comes back.

    Args:
        settings: all of them.
        camera: intrinsics at the size of the frames.
        log: where every step and change of state is noted.
        needs_telemetry: False for recorded video alone, which then runs in the body's frame.
    """

    def __init__(
        self,
        settings: Settings,
        camera: CameraModel,
        log: FlightLog,
        needs_telemetry: bool = True,
    ) -> None:
        mount = settings.camera.mount
        self._sighter = Sighter(camera, mount, settings.camera.latency_s)
        self._sighter.looks_down = settings.servo.mode is Mode.OVERHEAD
        self._attitudes = AttitudeHistory()
        self._liveness = Liveness()
        self._place_liveness = PositionLiveness()
        self._sound = SoundTelemetry()
        self._estimator = TargetEstimator(settings.estimator)
        self._servo = VisualServo(settings.servo, mount.pitch_rad)
        self._envelope = Envelope(settings.envelope)
        self._search = Search(settings.search)
        self._humans = HumanInput(settings.consent, settings.sticks)
        self._hand_back = HandBack(settings.release)
        self._supervisor = Supervisor(settings.supervisor)
        self.settings = settings
        self._log = log
        self._needs_telemetry = needs_telemetry
        self._allowed = HOLD
        self._last_step_s: float | None = None
        self._newest: TrackRecord | None = None
        self._seen_s = -math.inf
        self._believed: TargetEstimate | None = None
        self._sent = self._held = False
        self._gimbals = GimbalHistory() if settings.gimbal.enabled else None
        self._gimbal_servo = GimbalServo(settings.gimbal)
        self._mode_asked: Mode | None = None
        self._health = VehicleHealth()

    @property
    def supervisor(self) -> Supervisor:
        """Who decides."""
        return self._supervisor

    @property
    def servo(self) -> VisualServo:
        """Whose errors are worth showing."""
        return self._servo

    def request_stop(self) -> None:
        """Let go at the next step, whatever the state; may be called from any thread."""
        self._humans.stop_requested = True

    def change_mode(self, mode: Mode) -> None:
        """Follow another way from the next step on; may be called from any thread."""
        self._mode_asked = mode

    def order(self, order: Order) -> None:
        """Take an operator's order for the next step; may be called from any thread."""
        self._humans.give(order)

    def renew_consent(self) -> None:
        """Allow following again after a release; may be called from any thread."""
        self.order(Order.RENEW)

    def repeat_requests(self, recorded: Situation) -> None:
        """Ask for what was asked for in a recorded situation, before its step is replayed."""
        self._humans.repeat(recorded)

    def step(
        self,
        now_s: float,
        newest: TrackRecord | None,
        vehicle: VehicleState,
        attitudes: Sequence[Attitude] = (),
        late_s: float = 0.0,
        health: VehicleHealth | None = None,
    ) -> ControlRecord:
        """Do one step and return what came of it.

        Args:
            now_s: time of this step.
            newest: vision's newest answer, the same one again if there is no newer.
            vehicle: newest telemetry.
            attitudes: the attitudes that came since the last step.
            late_s: how far behind its schedule the step begins, for the log.
            health: what the vehicle told of its health; None if nothing new.
        """
        timer = Stopwatch()
        vehicle, reported = self._sound.of(vehicle), vehicle
        for attitude in attitudes:
            if self._attitudes.add(attitude):
                self._liveness.note(attitude, now_s)
        self._place_liveness.note(vehicle.position, now_s)
        if self._gimbals is not None and vehicle.gimbal is not None:
            self._gimbals.add(vehicle.gimbal)
        mode_asked = self._take_mode()
        news = health if health is not None and health != self._health else None
        self._health = news or self._health
        self._take_track(newest, now_s)
        estimate = self._estimator.estimate(now_s)
        situation = self._situation(now_s, estimate, vehicle)
        state = self._decide(now_s, situation, vehicle)
        self._remember(state, estimate, vehicle, now_s)
        limited = self._steer(state, now_s, estimate, vehicle)
        self._sent = self._sends(state, vehicle)
        self._held = self._sent and vehicle.obeys_setpoints
        record = ControlRecord(
            time_s=now_s,
            late_s=late_s,
            busy_s=timer.elapsed_s(),
            state=state,
            reason=self._supervisor.reason,
            estimate=estimate,
            track_captured_s=None if self._newest is None else self._newest.captured_s,
            vehicle=reported,
            asked=limited.asked,
            allowed=limited.allowed,
            limits=tuple(limited.limits),
            sent=self._sent,
            track_sequence=None if self._newest is None else self._newest.sequence,
            situation=situation,
            attitudes=tuple(attitudes),
            gimbal=self._turn_gimbal(now_s, estimate, vehicle),
            mode_asked=mode_asked,
            health=news,
        )
        self._last_step_s = now_s
        self._log.add_control(record)
        return record

    def _take_mode(self) -> Mode | None:
        """Begin to follow the way that was asked for, and return it."""
        mode, self._mode_asked = self._mode_asked, None
        if mode is not None:
            self._servo.change_mode(mode, self._allowed)
            self._sighter.looks_down = mode is Mode.OVERHEAD
        return mode

    def _turn_gimbal(
        self, now_s: float, estimate: TargetEstimate | None, vehicle: VehicleState
    ) -> GimbalRates | None:
        """Keep the target in the gimbal's camera, whoever flies the vehicle."""
        if self._gimbals is None:
            return None
        return self._gimbal_servo.update(estimate, vehicle.gimbal, vehicle.attitude, now_s)

    def _take_track(self, newest: TrackRecord | None, now_s: float) -> None:
        if newest is None or newest is self._newest:
            return
        self._newest = newest
        track = newest.track
        if track is not None and track.state is TrackState.TRACKING:
            self._observe(track, now_s)

    def _observe(self, track: Track, now_s: float) -> None:
        self._seen_s = track.captured_s
        sighting = self._sighter.sight(track, self._attitudes, self._gimbals)
        if sighting is not None:
            verdict = self._estimator.observe(sighting)
            self._log.observe(Observation(now_s, sighting, verdict))

    def _decide(self, now_s: float, situation: Situation, vehicle: VehicleState) -> State:
        before, reason = self._supervisor.state, self._supervisor.reason
        state = self._supervisor.step(situation, now_s)
        if state is not before or self._supervisor.reason is not reason:
            self._log.note(now_s, "supervisor", f"{state}: {self._supervisor.reason}")
        if state.engaged and not before.engaged:
            self._begin(vehicle, now_s)
        if state is State.SEARCHING and before is not state:
            self._search.start(self._believed, vehicle)
        return state

    def _remember(
        self, state: State, estimate: TargetEstimate | None, vehicle: VehicleState, now_s: float
    ) -> None:
        """Keep where the target was last believed to be, and whether the vehicle is handed back."""
        if state.steers and estimate is not None:
            self._believed = estimate
        self._hand_back.step(state, self._supervisor.in_state_s(now_s), vehicle, now_s)

    def _situation(
        self, now_s: float, estimate: TargetEstimate | None, vehicle: VehicleState
    ) -> Situation:
        newest, state = self._newest, self._supervisor.state
        track = None if newest is None else newest.track
        humans = self._humans
        humans.step(vehicle, state, now_s)
        telemetry_age_s = max(
            vehicle.attitude_age_s(now_s),
            vehicle.position_age_s(now_s),
            self._liveness.age_s(now_s),
            self._place_liveness.age_s(now_s),
        )
        engaged = self._supervisor.state.engaged
        verdict = judge(self._health, self.settings.health, engaged, now_s)
        return Situation(
            target_chosen=track is not None,
            unseen_s=self._unseen_s(track, now_s),
            estimate_good=estimate is not None and _is_good(estimate),
            heartbeat_age_s=vehicle.heartbeat_age_s(now_s),
            telemetry_age_s=telemetry_age_s if self._needs_telemetry else 0.0,
            frame_age_s=math.inf if newest is None else now_s - newest.captured_s,
            control_gap_s=0.0 if self._last_step_s is None else now_s - self._last_step_s,
            mode_allows=humans.mode_allows(vehicle, state),
            flying=vehicle.armed and vehicle.landed is not True,
            stop_requested=humans.stop_requested,
            consent_renewed=humans.consent_renewed,
            in_state_s=self._supervisor.in_state_s(now_s),
            consent_given=humans.consent_given,
            failsafe=vehicle.failsafe,
            sticks_moved=humans.sticks_moved,
            mode_left=self._held and not vehicle.obeys_setpoints,
            answer_age_s=vehicle.answer_age_s(now_s),
            order=humans.order,
            battery_low=verdict.battery_low,
            navigation_poor=verdict.navigation_poor,
        )

    def _unseen_s(self, track: Track | None, now_s: float) -> float:
        if track is not None and track.state is TrackState.TRACKING:
            return 0.0
        return now_s - self._seen_s

    def _begin(self, vehicle: VehicleState, now_s: float) -> None:
        present = heading_velocity(vehicle)
        self._servo.start(present)
        self._envelope.start(present, now_s)
        self._allowed = present
        self._humans.begin(vehicle)

    def _steer(
        self,
        state: State,
        now_s: float,
        estimate: TargetEstimate | None,
        vehicle: VehicleState,
    ) -> LimitedSetpoint:
        if state is not State.READY and self._sends(state, vehicle):
            asked = self._ask(state, now_s, estimate, vehicle)
            limited = self._envelope.limit(asked, now_s, self._context(now_s, estimate, vehicle))
        else:
            self._envelope.start(HOLD, now_s)
            limited = LimitedSetpoint(HOLD, HOLD, ())
        self._allowed = limited.allowed
        return limited

    def _ask(
        self, state: State, now_s: float, estimate: TargetEstimate | None, vehicle: VehicleState
    ) -> VelocitySetpoint:
        """Return what is wanted, before the envelope."""
        if state is State.SEARCHING:
            return self._search.update(vehicle, now_s)
        if not state.steers or estimate is None:
            return HOLD
        self._servo.nudge(self._humans.nudge)
        asked = self._servo.update(estimate, vehicle, self._allowed)
        if state is State.COASTING:
            return slowed(asked, now_s - self._seen_s, self.settings.supervisor.coast_s)
        return asked

    def _context(
        self, now_s: float, estimate: TargetEstimate | None, vehicle: VehicleState
    ) -> FlightContext:
        errors, context = self._servo.errors, FlightContext.of(vehicle, now_s)
        if errors is None:
            return context
        context = replace(
            context,
            target_range_m=errors.range_m,
            target_bearing_rad=errors.azimuth_rad,
            target_speed_m_s=errors.target_speed_m_s,
        )
        return context if estimate is None else self._seen_from(context, estimate)

    def _seen_from(self, context: FlightContext, estimate: TargetEstimate) -> FlightContext:
        """Add what the estimate says; the target is no farther away than the ground behind it."""
        elevation, range_m = estimate.height_angle_rad, context.target_range_m
        height_m = context.height_m if context.clearance_m is None else context.clearance_m
        if height_m is not None and range_m is not None:
            range_m = min(range_m, range_to_ground(height_m, elevation))
        return replace(
            context,
            target_range_m=range_m,
            target_elevation_rad=elevation,
            trust=trust_in(estimate, self.settings.envelope.trust),
        )

    def _sends(self, state: State, vehicle: VehicleState) -> bool:
        """Whether a setpoint is to be sent.

        A stream that the autopilot flies by is not broken off, whatever the state: silence would
        send PX4 home. Once the pilot has another mode, nothing is sent, and ArduCopter's GUIDED is
        somebody else's when it comes back; OFFBOARD needs a stream from whom it had one.
        """
        if self._hand_back.done:
            return False
        comes_back = state is State.RELEASED and vehicle.mode == _NEEDS_STREAM
        return state.streams or (vehicle.obeys_setpoints and (self._sent or comes_back))


def heading_velocity(vehicle: VehicleState) -> VelocitySetpoint:
    """Return the vehicle's present motion as a setpoint; standing still where it is unknown."""
    position, attitude = vehicle.position, vehicle.attitude
    if position is None or attitude is None:
        return HOLD
    c, s = math.cos(attitude.yaw_rad), math.sin(attitude.yaw_rad)
    return VelocitySetpoint(
        c * position.north_m_s + s * position.east_m_s,
        c * position.east_m_s - s * position.north_m_s,
        position.down_m_s,
        attitude.yaw_rate_rad_s,
    )


def _is_good(estimate: TargetEstimate) -> bool:
    variance = max(float(estimate.covariance[0, 0]), float(estimate.covariance[1, 1]))
    return variance < _GOOD_DIRECTION_RAD**2
