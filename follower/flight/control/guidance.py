"""From the supervisor's state and the estimate to what may be sent."""

import math
from dataclasses import replace

from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.settings import Settings
from follower_control.envelope.envelope import Envelope, LimitedSetpoint
from follower_control.envelope.flight_context import FlightContext
from follower_control.servo.output_blend import slowed
from follower_control.servo.search import Search
from follower_control.servo.servo import VisualServo
from follower_control.target.estimate import TargetEstimate, range_to_ground
from follower_control.target.estimator import trust_in
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import PresentMotion, VehicleState


class Guidance:
    """The servo for a target that is seen, the search for a lost one, the envelope behind both.

    Args:
        settings: of all three, and of the camera's mount.

    Attributes:
        servo: its errors are worth showing.
    """

    def __init__(self, settings: Settings) -> None:
        self.servo = VisualServo(
            settings.servo, settings.camera.mount.pitch_rad, settings.envelope.max_descent_m_s
        )
        self._settings = settings
        self._envelope = Envelope(settings.envelope)
        self._search = Search(settings.search, settings.camera.view_rad)
        self._motion = PresentMotion()
        self._allowed = HOLD
        self._allowed_s = math.inf
        self._believed: TargetEstimate | None = None

    @property
    def stands(self) -> bool:
        """Whether the last setpoint was to stand still."""
        return self._allowed == HOLD

    def sent_m(self, now_s: float) -> float:
        """Return how far, in metres, the last setpoint has sent the vehicle until now."""
        speed_m_s = math.hypot(*self._allowed.values[:3])
        return speed_m_s * max(0.0, now_s - self._allowed_s)

    def take_telemetry(self, vehicle: VehicleState) -> None:
        """Take the newest telemetry, whoever flies."""
        self._motion.update(vehicle)

    def begin(self, vehicle: VehicleState, now_s: float) -> None:
        """Begin to steer, from the vehicle's present motion, or from what it is sent if not a hold.

        A hold near a target backs off.
        """
        self.take_telemetry(vehicle)
        if self.stands:
            self._allowed = self._envelope.within_limits(self._motion.present)
            self._envelope.start(self._allowed, now_s)
        self.servo.start(self._allowed)

    def begin_search(self, vehicle: VehicleState) -> None:
        """Begin to look for the target, from where it was last believed to be."""
        self._search.start(self._believed, vehicle)

    def change(self, settings: Settings) -> None:
        """Go on by other settings, without a step in the setpoints."""
        before, self._settings = self._settings, settings
        self.servo.change(settings.servo, settings.envelope.max_descent_m_s)
        if settings.servo.mode is not before.servo.mode:
            self.servo.change_mode(settings.servo.mode, self._allowed)
        self._envelope.change(settings.envelope)
        self._search.change(settings.search)

    def take_another(self) -> None:
        """Begin with another target, from the present setpoint; its size now is what is held."""
        self.servo.start(self._allowed)
        self._believed = None

    def stand_by(self, now_s: float) -> LimitedSetpoint:
        """Return a hold at `now_s`, in seconds, for a vehicle that others fly."""
        self._envelope.start(HOLD, now_s)
        self._allowed, self._allowed_s = HOLD, now_s
        return LimitedSetpoint(HOLD, HOLD, ())

    def step(
        self,
        state: SupervisorState,
        now_s: float,
        estimate: TargetEstimate | None,
        vehicle: VehicleState,
        unseen_s: float,
    ) -> LimitedSetpoint:
        """Return the setpoint for a vehicle that flies by ours.

        Args:
            state: the supervisor's.
            now_s: time of this step.
            estimate: the target, predicted to now.
            vehicle: newest telemetry.
            unseen_s: since the last frame that showed the target.
        """
        if state.steers and estimate is not None:
            self._believed = estimate
        asked = self._ask(state, now_s, estimate, vehicle, unseen_s)
        limited = self._envelope.limit(asked, now_s, self._context(now_s, estimate, vehicle))
        self._allowed, self._allowed_s = limited.allowed, now_s
        return limited

    def _ask(
        self,
        state: SupervisorState,
        now_s: float,
        estimate: TargetEstimate | None,
        vehicle: VehicleState,
        unseen_s: float,
    ) -> VelocitySetpoint:
        """Return what is wanted, before the envelope."""
        if state is SupervisorState.SEARCHING:
            if estimate is not None:
                self._search.aim(self.servo.pursuit.world_estimate(estimate, vehicle))
            believed = self._believed
            if believed is not None and believed.frame is BearingFrame.WORLD:
                self._search.spread(self.servo.pursuit.possible_bearings(vehicle, now_s))
            return self._search.update(vehicle, now_s)
        if not state.steers or estimate is None:
            return HOLD
        asked = self.servo.update(estimate, vehicle, self._allowed)
        if state is SupervisorState.COASTING:
            return slowed(asked, unseen_s, self._settings.supervisor.coast_s)
        return asked

    def _context(
        self, now_s: float, estimate: TargetEstimate | None, vehicle: VehicleState
    ) -> FlightContext:
        errors, context = self.servo.errors, FlightContext.of(vehicle, now_s)
        if errors is None:
            return context
        range_m, elevation, trust = errors.least_range_m, None, None
        if estimate is not None:
            elevation = estimate.height_angle_rad
            range_m = self._before_the_ground(range_m, elevation, context)
            trust = trust_in(estimate, self._settings.envelope.trust)
        return replace(
            context,
            target_range_m=range_m,
            target_bearing_rad=errors.azimuth_rad,
            target_speed_m_s=errors.sure_speed_m_s,
            target_elevation_rad=elevation,
            trust=trust,
        )

    def _before_the_ground(self, range_m: float, elevation: float, context: FlightContext) -> float:
        """Return the range; the target is no farther away than the ground behind it."""
        height_m = context.height_m if context.clearance_m is None else context.clearance_m
        if height_m is None:
            return range_m
        above_m = height_m - self._settings.servo.target_middle_m
        return min(range_m, range_to_ground(above_m, elevation))
