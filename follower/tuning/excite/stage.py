"""The control stage with a pattern in the target's place."""

from dataclasses import replace

from follower.flight.control.guidance import Guidance
from follower.flight.control.stage import ControlStage
from follower.flight.log import FlightLog
from follower.flight.supervision.inputs import SupervisorInputs
from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.settings import Settings
from follower.tuning.excite.pattern import Pattern
from follower_control.target.estimate import TargetEstimate
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import VehicleState
from follower_vision.geometry.camera_model import CameraModel


class ExcitationGuidance(Guidance):
    """Asks for the pattern while the supervisor says FOLLOWING; the envelope stands behind it.

    A pause, whatever the reason, continues the pattern where it was interrupted.

    Attributes:
        elapsed_s: how much of the pattern is flown.
    """

    def __init__(self, settings: Settings, pattern: Pattern) -> None:
        super().__init__(settings)
        self._pattern = pattern
        self._last_s: float | None = None
        self.elapsed_s = 0.0

    @property
    def done(self) -> bool:
        """Whether all of it is flown."""
        return self.elapsed_s >= self._pattern.length_s

    def _ask(
        self,
        state: SupervisorState,
        now_s: float,
        _estimate: TargetEstimate | None,
        _vehicle: VehicleState,
        _unseen_s: float,
    ) -> VelocitySetpoint:
        if state is not SupervisorState.FOLLOWING:
            self._last_s = None
            return HOLD
        if self._last_s is not None:
            self.elapsed_s += max(0.0, now_s - self._last_s)
        self._last_s = now_s
        return self._pattern.setpoint(self.elapsed_s)


class ExcitationStage(ControlStage):
    """Who may move the vehicle, what is recorded, how it is released: all as in a pursuit.

    Only the target is missing: the supervisor's inputs say that one is tracked as soon as `ready`
    is set, and every other row of its tables holds. After the pattern it is asked to stop, which
    holds and releases.

    Args:
        settings: those of `excitation_settings`.
        pattern: what to fly.
        camera: of nothing; it only completes the recording.
        log: where every step is noted.

    Attributes:
        ready: the vehicle is where the pattern may begin.
    """

    def __init__(
        self, settings: Settings, pattern: Pattern, camera: CameraModel, log: FlightLog
    ) -> None:
        super().__init__(settings, camera, log)
        self._excitation = ExcitationGuidance(settings, pattern)
        self._guidance = self._excitation
        self.ready = False

    @property
    def elapsed_s(self) -> float:
        """How much of the pattern is flown, seconds."""
        return self._excitation.elapsed_s

    def repeat_requests(self, recorded: SupervisorInputs) -> None:
        """Ask for what was asked for in recorded inputs, before its step is replayed."""
        super().repeat_requests(recorded)
        self.ready = recorded.target_chosen

    def _situation(
        self, now_s: float, estimate: TargetEstimate | None, vehicle: VehicleState
    ) -> SupervisorInputs:
        if self._excitation.done:
            self.request_stop()
        situation = super()._situation(now_s, estimate, vehicle)
        return replace(
            situation,
            target_chosen=self.ready,
            unseen_s=0.0,
            estimate_good=True,
            frame_age_s=0.0,
        )


def excitation_settings(settings: Settings) -> Settings:
    """Return the settings without the distance to the target, which only a target can give."""
    return settings.model_copy(update={"envelope": replace(settings.envelope, min_distance_m=None)})
