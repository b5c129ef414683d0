"""Tracks and telemetry in, setpoints out: one step of the control loop."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence

from follower.flightlog import ControlRecord, FlightLog, Observation, TrackRecord
from follower.health import judge
from follower.human_input import HumanInput
from follower.links.vehicle_health import VehicleHealth
from follower.operator_requests import NOTHING, OperatorRequests
from follower.release import HandBack
from follower.setpoint_stream import SetpointStream
from follower.setting_change import SettingChange, changed
from follower.settings import Settings
from follower.situation import Order, Situation
from follower.steering import Steering
from follower.stopwatch import Stopwatch
from follower.supervisor import State, Supervisor
from follower_control.attitude_history import AttitudeHistory
from follower_control.envelope import LimitedSetpoint
from follower_control.estimate import TargetEstimate
from follower_control.estimator import TargetEstimator
from follower_control.gimbal import GimbalRates
from follower_control.gimbal_history import GimbalHistory
from follower_control.gimbal_servo import GimbalServo
from follower_control.liveness import Liveness, PositionLiveness
from follower_control.outlook import prospect
from follower_control.servo import VisualServo
from follower_control.servo_settings import Mode
from follower_control.sighter import Sighter
from follower_control.sound_telemetry import SoundTelemetry
from follower_control.strict_yaml import SettingsError
from follower_control.vehicle import Attitude, VehicleState
from follower_vision.camera import CameraModel
from follower_vision.prospect import Prospect
from follower_vision.track import Track, TrackState

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
        self._sighter = Sighter(camera, mount, settings.camera.latency_s)
        self._sighter.looks_down = settings.servo.mode is Mode.OVERHEAD
        self._attitudes = AttitudeHistory()
        self._liveness = Liveness()
        self._place_liveness = PositionLiveness()
        self._sound = SoundTelemetry()
        self._estimator = TargetEstimator(settings.estimator)
        self._steering = Steering(settings)
        autonomous = settings.autonomy == "full"
        self._humans = HumanInput(settings.consent, settings.sticks, settings.cockpit, autonomous)
        self._hand_back = HandBack(settings.release)
        self._supervisor = Supervisor(settings.supervisor)
        self.settings = settings
        self._asks_often = settings.link.asks_often
        self._log = log
        self._needs_telemetry = needs_telemetry
        self._newest: TrackRecord | None = None
        self._seen_s = self._let_go_s = -math.inf
        self._stream = SetpointStream(settings.supervisor.alone_s)
        self._gimbals = GimbalHistory() if settings.gimbal.enabled else None
        self._gimbal_servo = GimbalServo(settings.gimbal)
        self._mode_asked: Mode | None = None
        self._health = VehicleHealth()
        self._requests = requests
        self._target_requests = 0
        self._changes_asked: list[SettingChange] = []
        self._lock = threading.Lock()  # vision asks for prospects between the steps

    @property
    def supervisor(self) -> Supervisor:
        """Who decides."""
        return self._supervisor

    @property
    def servo(self) -> VisualServo:
        """Whose errors are worth showing."""
        return self._steering.servo

    def request_stop(self) -> None:
        """Let go at the next step, whatever the state; may be called from any thread."""
        self._humans.ask_to_stop()

    def change_mode(self, mode: Mode) -> None:
        """Follow another way from the next step on; may be called from any thread."""
        self._mode_asked = mode

    def order(self, order: Order) -> None:
        """Take an operator's order for the next step; may be called from any thread."""
        self._humans.give(order)

    def hear_cockpit(self) -> None:
        """Note that the page in control is there; may be called from any thread."""
        self._humans.cockpit.hear()

    def renew_consent(self) -> None:
        """Allow following again after a release; may be called from any thread."""
        self.order(Order.RENEW)

    def repeat_requests(self, recorded: Situation) -> None:
        """Ask for what was asked for in a recorded situation, before its step is replayed."""
        self._humans.repeat(recorded)

    def repeat_changes(self, changes: Sequence[SettingChange]) -> None:
        """Change settings with the next step, as they were changed in a recorded one."""
        self._changes_asked += changes

    def may_call_back(self, vehicle: VehicleState) -> bool:
        """Whether a setpoint could end a failsafe that we have not heard of."""
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
            health: what the vehicle told of its health; None if nothing new.
        """
        with self._lock:
            return self._step(now_s, newest, vehicle, attitudes, late_s, health)

    def prospect(self, captured_s: float, target_requests: int) -> Prospect | None:
        """Return where in a frame the target can be, None if that is not known; from any thread.

        Args:
            captured_s: the frame's time stamp.
            target_requests: how many wishes for a target vision has carried out: of one that was
                chosen a moment ago nothing is known here.
        """
        with self._lock:
            time_s, sighter = self._sighter.exposed_s(captured_s), self._sighter
            outlook = self.servo.outlook(time_s)
            if outlook is None or target_requests != self._target_requests:
                return None
            earlier = self.servo.earlier_outlooks(time_s)
            held = self._attitudes, self._gimbals
            return prospect(outlook, sighter, captured_s, *held, earlier)

    def _step(
        self,
        now_s: float,
        newest: TrackRecord | None,
        vehicle: VehicleState,
        attitudes: Sequence[Attitude],
        late_s: float,
        health: VehicleHealth | None,
    ) -> ControlRecord:
        timer = Stopwatch()
        vehicle, reported = self._sound.of(vehicle), vehicle
        self._hear(vehicle, attitudes, now_s)
        changes = self._take_requests(now_s)
        mode_asked = self._take_mode()
        news = health if health is not None and health != self._health else None
        self._health = news or self._health
        self._take_track(newest, now_s)
        estimate = self._estimator.estimate(now_s)
        situation = self._situation(now_s, estimate, vehicle)
        state = self._decide(now_s, situation, vehicle)
        self._hand_back.step(state, self._supervisor.in_state_s(now_s), vehicle, now_s)
        self._stream.step(state, vehicle, attitudes, now_s, self._hand_back.done)
        limited = self._steer(now_s, state, estimate, vehicle, situation.stop_at_once)
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
            sent=self._stream.sent,
            track_sequence=None if self._newest is None else self._newest.sequence,
            situation=situation,
            attitudes=tuple(attitudes),
            gimbal=self._turn_gimbal(now_s, estimate, vehicle),
            mode_asked=mode_asked,
            health=news,
            changes=changes,
        )
        self._log.add_control(record)
        return record

    def _hear(self, vehicle: VehicleState, attitudes: Sequence[Attitude], now_s: float) -> None:
        """Remember what turns lines of sight, and when telemetry last was alive."""
        for attitude in attitudes:
            if self._attitudes.add(attitude):
                self._liveness.note(attitude, now_s)
        sent_m = self._steering.sent_m(now_s) if self._stream.held else 0.0
        self._place_liveness.note(vehicle.position, now_s, sent_m)
        self._steering.hear(vehicle)
        if self._gimbals is not None and vehicle.gimbal is not None:
            self._gimbals.add(vehicle.gimbal)

    def _take_requests(self, now_s: float) -> tuple[SettingChange, ...]:
        """Obey the operators, and return the settings that were changed."""
        asked = NOTHING if self._requests is None else self._requests.take()
        for note in asked.notes:
            self._log.note(now_s, "operator", note)
        for order in asked.orders:
            self._humans.give(order)
        if asked.stop:
            self._humans.press_stop()
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
        self._steering.change(settings)
        self._supervisor.change(settings.supervisor)
        self._stream.change(settings.supervisor.alone_s)
        self._sighter.looks_down = self.servo.mode is Mode.OVERHEAD

    def _take_mode(self) -> Mode | None:
        """Begin to follow the way that was asked for, and return it."""
        mode, self._mode_asked = self._mode_asked, None
        if mode is not None:
            self._steering.change_mode(mode)
            self._sighter.looks_down = mode is Mode.OVERHEAD
        return mode

    def _steer(
        self,
        now_s: float,
        state: State,
        estimate: TargetEstimate | None,
        vehicle: VehicleState,
        stop_at_once: bool,
    ) -> LimitedSetpoint:
        brakes = vehicle.obeys_setpoints and not self._steering.stands
        ready = state is State.READY and not brakes
        if ready or not self._stream.sent or stop_at_once:
            return self._steering.stand_by(now_s)
        self.servo.nudge(self._humans.nudge)
        return self._steering.step(state, now_s, estimate, vehicle, now_s - self._seen_s)

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
        if newest.requests != self._target_requests:
            self._target_requests = newest.requests
            self._begin_with_another(track)
        if track is not None and track.state is TrackState.TRACKING:
            self._observe(track, now_s)

    def _begin_with_another(self, track: Track | None) -> None:
        """Forget the target before this one, which an operator chose, or wanted none."""
        self._estimator.reset()
        self._seen_s = -math.inf
        if track is not None and track.captured_s > self._let_go_s:
            self._humans.choose()
        self._steering.take_another()

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
            self._steering.begin(vehicle, now_s)
            self._humans.begin(vehicle)
        if state is State.RELEASED and before is not state:
            self._let_go_s = now_s
            if self._requests is not None:
                self._requests.let_go()
        if state is State.SEARCHING and before is not state:
            self._steering.begin_search(vehicle)
        return state

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
        unseen_s = self._unseen_s(track, now_s)
        verdict = judge(self._health, self.settings.health, engaged, now_s)
        return Situation(
            target_chosen=track is not None,
            unseen_s=unseen_s,
            estimate_good=estimate is not None and self._is_good(estimate, unseen_s),
            heartbeat_age_s=vehicle.heartbeat_age_s(now_s),
            telemetry_age_s=telemetry_age_s if self._needs_telemetry else 0.0,
            frame_age_s=math.inf if newest is None else now_s - newest.captured_s,
            control_gap_s=self._stream.gap_s(now_s),
            mode_allows=humans.mode_allows(vehicle, state),
            flying=vehicle.armed and vehicle.landed is not True,
            stop_requested=humans.stop_requested,
            consent_renewed=humans.consent_renewed,
            in_state_s=self._supervisor.in_state_s(now_s),
            consent_given=humans.consent_given,
            failsafe=vehicle.failsafe,
            sticks_moved=humans.sticks_moved,
            mode_left=self._stream.was_left(vehicle),
            stream_held=self._stream.held,
            answer_age_s=vehicle.answer_age_s(now_s) if self._asks_often else 0.0,
            order=humans.order,
            battery_low=verdict.battery_low,
            navigation_poor=verdict.navigation_poor,
            stop_at_once=humans.stop_at_once,
            cockpit_lost=humans.cockpit_lost,
        )

    def _is_good(self, estimate: TargetEstimate, unseen_s: float) -> bool:
        """Whether the predicted direction may be steered by; while coasting, settings say."""
        limit = _GOOD_DIRECTION_RAD
        if unseen_s > 0 and self._supervisor.state.steers:
            limit = math.radians(self.settings.supervisor.coast_within_deg)
        variance = max(float(estimate.covariance[0, 0]), float(estimate.covariance[1, 1]))
        return variance < limit**2

    def _unseen_s(self, track: Track | None, now_s: float) -> float:
        if track is not None and track.state is TrackState.TRACKING:
            return 0.0
        return now_s - self._seen_s
