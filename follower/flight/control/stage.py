"""Tracks and telemetry in, setpoints out: one step of the control loop."""

import math
import threading
from collections.abc import Sequence

from follower.flight.control.guidance import Guidance
from follower.flight.log import ControlRecord, FlightLog, ObservationRecord, Stopwatch, TrackRecord
from follower.flight.operator_requests import NOTHING, OperatorRequests
from follower.flight.supervision.flight_end import FlightEnd, LastRelease
from follower.flight.supervision.inputs import ConsentRequest, SupervisorInputs, judge
from follower.flight.supervision.pilot_and_operator import PilotOperatorInput
from follower.flight.supervision.release import SetpointHandover
from follower.flight.supervision.setpoint_stream import SetpointStream
from follower.flight.supervision.supervisor import Supervisor, SupervisorState
from follower.links.vehicle_health import VehicleHealth
from follower.settings.live import SettingChange, changed
from follower.settings.settings import Settings
from follower_control.common.strict_config import SettingsError
from follower_control.envelope.envelope import LimitedSetpoint
from follower_control.servo.gimbal_servo import GimbalServo
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import FollowMode
from follower_control.target.estimate import TargetEstimate
from follower_control.target.estimator import TargetEstimator
from follower_control.target.image_prediction import prospect
from follower_control.target.observation import BearingObserver
from follower_control.vehicle.gimbal import GimbalHistory, GimbalRates
from follower_control.vehicle.history import AttitudeHistory
from follower_control.vehicle.stale_data import (
    PlausibleTelemetryFilter,
    StuckPositionDetector,
    StuckSensorDetector,
)
from follower_control.vehicle.state import Attitude, VehicleState
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.trackers.target_tracker import TargetPrediction
from follower_vision.trackers.track import Track, TrackState

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
        requests: what operators want is taken from there, if given.

    Attributes:
        settings: the present ones, changes in flight included.
        supervisor: decides who moves the vehicle.
    """

    def __init__(
        self,
        settings: Settings,
        camera: CameraModel,
        log: FlightLog,
        needs_telemetry: bool = True,
        requests: OperatorRequests | None = None,
    ) -> None:
        mount = settings.camera.mount
        self._observer = BearingObserver(camera, mount, settings.camera.latency_s)
        self._observer.looks_down = settings.servo.mode is FollowMode.OVERHEAD
        self._attitudes = AttitudeHistory()
        self._stuck_attitude = StuckSensorDetector()
        self._stuck_position = StuckPositionDetector()
        self._finite = PlausibleTelemetryFilter()
        self._estimator = TargetEstimator(settings.estimator)
        self._guidance = Guidance(settings)
        autonomous = settings.autonomy == "full"
        self._operators = PilotOperatorInput(
            settings.consent, settings.sticks, settings.cockpit, autonomous
        )
        self._handover = SetpointHandover(settings.release)
        self.supervisor = Supervisor(settings.supervisor)
        self._release = LastRelease()
        self.settings = settings
        self._asks_often = settings.link.asks_often
        self._log = log
        self._needs_telemetry = needs_telemetry
        self._newest: TrackRecord | None = None
        self._seen_s = self._released_s = -math.inf
        self._stream = SetpointStream(settings.supervisor.alone_s)
        self._gimbals = GimbalHistory() if settings.gimbal.enabled else None
        self._gimbal_servo = GimbalServo(settings.gimbal)
        self._health = VehicleHealth()
        self._requests = requests
        self._target_requests, self._replaced = 0, 0
        self._changes_asked: list[SettingChange] = []
        self._lock = threading.Lock()  # vision asks for prospects between the steps

    @property
    def servo(self) -> VisualServo:
        """Whose errors are worth showing."""
        return self._guidance.servo

    @property
    def end(self) -> FlightEnd:
        """How the flight has ended, if it ends now."""
        return self._release.end

    def request_stop(self, why: FlightEnd | None = None) -> None:
        """Release the vehicle at the next step, whatever the state; from any thread.

        `why` is how the flight ends, if not as asked; the first one counts.
        """
        self._release.stopped_by = self._release.stopped_by or why
        self._operators.ask_to_stop()

    def order(self, order: ConsentRequest) -> None:
        """Take an operator's order for the next step; may be called from any thread."""
        self._operators.give(order)

    def note_cockpit(self) -> None:
        """Note that the page in control is there; may be called from any thread."""
        self._operators.cockpit.note()

    def repeat_requests(self, recorded: SupervisorInputs) -> None:
        """Ask for what was asked for in a recorded situation, before its step is replayed."""
        self._operators.repeat(recorded)

    def repeat_changes(self, changes: Sequence[SettingChange]) -> None:
        """Change settings with the next step, as they were changed in a recorded one."""
        self._changes_asked += changes

    def may_call_back(self, vehicle: VehicleState) -> bool:
        """Whether a setpoint could end a failsafe that was not reported to us."""
        return self._stream.may_call_back(vehicle)

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
            health: what the vehicle reported of its health; None if nothing new.
        """
        with self._lock:
            timer = Stopwatch()
            vehicle, reported = self._finite.of(vehicle), vehicle
            self._take_telemetry(vehicle, attitudes, now_s)
            changes = self._take_requests(now_s)
            news = health if health is not None and health != self._health else None
            self._health = news or self._health
            self._take_track(newest, now_s)
            estimate = self._estimator.estimate(now_s)
            situation = self._situation(now_s, estimate, vehicle)
            state = self._decide(now_s, situation, vehicle)
            self._handover.step(state, self.supervisor.in_state_s(now_s), vehicle, now_s)
            self._stream.step(state, vehicle, attitudes, now_s, self._handover.done)
            limited = self._steer(now_s, state, estimate, vehicle, situation.stop_at_once)
            record = ControlRecord(
                time_s=now_s,
                late_s=late_s,
                busy_s=timer.elapsed_s(),
                state=state,
                reason=self.supervisor.reason,
                estimate=estimate,
                track_captured_s=None if self._newest is None else self._newest.captured_s,
                vehicle=reported,
                asked=limited.asked,
                allowed=limited.allowed,
                limits=tuple(limited.limits),
                sent=self._stream.sent,
                track_sequence=None if self._newest is None else self._newest.sequence,
                situation=situation,
                attitudes=tuple(attitudes),
                gimbal=self._turn_gimbal(now_s, estimate, vehicle, limited.allowed.yaw_rate_rad_s),
                health=news,
                changes=changes,
            )
            self._log.add_control(record)
            return record

    def prospect(self, captured_s: float, choices: int) -> TargetPrediction | None:
        """Return where in a frame the target can be, None if that is not known; from any thread.

        Args:
            captured_s: the frame's time stamp.
            choices: how many targets vision has been told to take in place of others: of one that
                was chosen a moment ago nothing is known here.
        """
        with self._lock:
            time_s, observer = self._observer.exposed_s(captured_s), self._observer
            outlook = self.servo.pursuit.predicted_region(time_s)
            if outlook is None or choices != self._target_requests + self._replaced:
                return None
            earlier = self.servo.pursuit.earlier_predictions(time_s)
            held = self._attitudes, self._gimbals
            return prospect(outlook, observer, captured_s, *held, earlier)

    def _take_telemetry(
        self, vehicle: VehicleState, attitudes: Sequence[Attitude], now_s: float
    ) -> None:
        """Remember what rotates lines of sight, and when telemetry last was alive."""
        for attitude in attitudes:
            if self._attitudes.add(attitude):
                self._stuck_attitude.note(attitude, now_s)
        sent_m = self._guidance.sent_m(now_s) if self._stream.held else 0.0
        self._stuck_position.note(vehicle.position, now_s, sent_m)
        self._guidance.take_telemetry(vehicle)
        if self._gimbals is not None and vehicle.gimbal is not None:
            self._gimbals.add(vehicle.gimbal)

    def _take_requests(self, now_s: float) -> tuple[SettingChange, ...]:
        """Obey the operators, and return the settings that were changed."""
        asked = NOTHING if self._requests is None else self._requests.take()
        for note in asked.notes:
            self._log.note(now_s, "operator", note)
        for order in asked.orders:
            self._operators.give(order)
        if asked.stop:
            self._operators.press_stop()
        if asked.settings is not None:
            self._change_settings(asked.settings)
        return (*self._repeated_changes(now_s), *asked.changes)

    def _repeated_changes(self, now_s: float) -> tuple[SettingChange, ...]:
        changes, self._changes_asked = tuple(self._changes_asked), []
        if changes:
            try:
                self._change_settings(changed(self.settings, changes))
            except SettingsError as error:
                self._log.note(now_s, "operator", f"not changed: {error}")
        return changes

    def _change_settings(self, settings: Settings) -> None:
        """Go on by other settings, without a step in the setpoints."""
        self.settings = settings
        self._guidance.change(settings)
        self.supervisor.change(settings.supervisor)
        self._stream.change(settings.supervisor.alone_s)
        self._observer.looks_down = self.servo.mode is FollowMode.OVERHEAD

    def _steer(
        self,
        now_s: float,
        state: SupervisorState,
        estimate: TargetEstimate | None,
        vehicle: VehicleState,
        stop_at_once: bool,
    ) -> LimitedSetpoint:
        brakes = vehicle.obeys_setpoints and not self._guidance.stands
        ready = state is SupervisorState.READY and not brakes
        if ready or not self._stream.sent or stop_at_once:
            return self._guidance.stand_by(now_s)
        self.servo.set_offset(self._operators.sticks.nudge)
        return self._guidance.step(state, now_s, estimate, vehicle, now_s - self._seen_s)

    def _turn_gimbal(
        self,
        now_s: float,
        estimate: TargetEstimate | None,
        vehicle: VehicleState,
        yaw_rate_rad_s: float,
    ) -> GimbalRates | None:
        """Keep the target in the gimbal's camera, whoever flies the vehicle."""
        if self._gimbals is None:
            return None
        if estimate is None and self.supervisor.state is SupervisorState.SEARCHING:
            return GimbalRates(yaw_rad_s=yaw_rate_rad_s)  # it would look where it looks, else
        return self._gimbal_servo.update(estimate, vehicle.gimbal, vehicle.attitude, now_s)

    def _take_track(self, newest: TrackRecord | None, now_s: float) -> None:
        if newest is None or newest is self._newest:
            return
        self._newest = newest
        track = newest.track
        requested, replaced = newest.requests, newest.replaced or 0
        by_operator = requested != self._target_requests
        if by_operator and track is not None and track.captured_s > self._released_s:
            self._operators.choose()
        if by_operator or replaced != self._replaced:
            self._target_requests, self._replaced = requested, replaced
            self._begin_with_another()
        if track is not None and track.state is TrackState.TRACKING:
            self._observe(track, now_s)

    def _begin_with_another(self) -> None:
        """Forget the target before this one, which somebody chose, or wanted none."""
        self._estimator.reset()
        self._seen_s = -math.inf
        self._guidance.take_another()

    def _observe(self, track: Track, now_s: float) -> None:
        self._seen_s = track.captured_s
        observation = self._observer.observe(track, self._attitudes, self._gimbals)
        if observation is not None:
            verdict = self._estimator.observe(observation)
            self._log.pass_on(ObservationRecord(now_s, observation, verdict), now_s)

    def _decide(
        self, now_s: float, situation: SupervisorInputs, vehicle: VehicleState
    ) -> SupervisorState:
        before, reason = self.supervisor.state, self.supervisor.reason
        state = self.supervisor.step(situation, now_s)
        self._release.take(state, self.supervisor.reason)
        if state is not before or self.supervisor.reason is not reason:
            self._log.note(now_s, "supervisor", f"{state}: {self.supervisor.reason}")
        if state.engaged and not before.engaged:
            self._guidance.begin(vehicle, now_s)
            self._operators.begin(vehicle)
        if state is SupervisorState.RELEASED and before is not state:
            self._released_s = now_s
            if self._requests is not None:
                self._requests.on_release()
        if state is SupervisorState.SEARCHING and before is not state:
            self._guidance.begin_search(vehicle)
        return state

    def _situation(
        self, now_s: float, estimate: TargetEstimate | None, vehicle: VehicleState
    ) -> SupervisorInputs:
        newest, state = self._newest, self.supervisor.state
        track = None if newest is None else newest.track
        operators = self._operators
        operators.step(vehicle, state, now_s)
        telemetry_age_s = max(
            vehicle.attitude_age_s(now_s),
            vehicle.position_age_s(now_s),
            self._stuck_attitude.age_s(now_s),
            self._stuck_position.age_s(now_s),
        )
        engaged = self.supervisor.state.engaged
        unseen_s = self._unseen_s(track, now_s)
        verdict = judge(self._health, self.settings.health, engaged, now_s)
        return SupervisorInputs(
            target_chosen=track is not None,
            unseen_s=unseen_s,
            estimate_good=estimate is not None and self._is_good(estimate, unseen_s),
            heartbeat_age_s=vehicle.heartbeat_age_s(now_s),
            telemetry_age_s=telemetry_age_s if self._needs_telemetry else 0.0,
            frame_age_s=math.inf if newest is None else now_s - newest.captured_s,
            control_gap_s=self._stream.gap_s(now_s),
            mode_allows=operators.mode_allows(vehicle, state),
            flying=vehicle.armed and vehicle.landed is not True,
            stop_requested=operators.stop_requested,
            consent_renewed=operators.consent.renewed,
            in_state_s=self.supervisor.in_state_s(now_s),
            consent_given=operators.consent.given,
            failsafe=vehicle.failsafe,
            sticks_moved=operators.sticks.taken_over,
            mode_left=self._stream.was_left(vehicle),
            stream_held=self._stream.held,
            answer_age_s=vehicle.answer_age_s(now_s) if self._asks_often else 0.0,
            order=operators.order,
            battery_low=verdict.battery_low,
            navigation_poor=verdict.navigation_poor,
            stop_at_once=operators.stop_at_once,
            cockpit_lost=operators.cockpit_lost,
        )

    def _is_good(self, estimate: TargetEstimate, unseen_s: float) -> bool:
        """Whether the predicted direction may be steered by; while coasting, settings say."""
        limit = _GOOD_DIRECTION_RAD
        if unseen_s > 0 and self.supervisor.state.steers:
            limit = math.radians(self.settings.supervisor.coast_within_deg)
        variance = max(float(estimate.covariance[0, 0]), float(estimate.covariance[1, 1]))
        return variance < limit**2

    def _unseen_s(self, track: Track | None, now_s: float) -> float:
        if track is not None and track.state is TrackState.TRACKING:
            return 0.0
        return now_s - self._seen_s
