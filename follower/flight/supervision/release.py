"""What becomes of the vehicle after a release when the pilot does not take it."""

import math

from follower.flight.supervision.supervisor import SupervisorReason, SupervisorState
from follower.links.vehicle_monitor import hold_mode
from follower.settings.supervisor import ReleaseAction, ReleaseSettings
from follower_control.vehicle.state import VehicleState

_RESTING_M_S, _RESTING_RAD_S = 0.3, 0.1
_LONGEST_STOP_S = 4.0
_FRESH_S = 0.5
_HELD_S = 1.0
_REFUSED_AFTER = 3
_TAKEOVERS = (SupervisorReason.PILOT_TOOK_OVER, SupervisorReason.STICKS_MOVED)


def release_mode(action: ReleaseAction, autopilot_name: str) -> str | None:
    """Return the autopilot's own mode for an action, None if it needs none."""
    if action is ReleaseAction.LOITER:
        return hold_mode(autopilot_name)
    return {ReleaseAction.RTL: "RTL", ReleaseAction.LAND: "LAND"}.get(action)


def is_resting(vehicle: VehicleState, now_s: float) -> bool:
    """Whether fresh telemetry says that the vehicle neither moves nor turns."""
    position, attitude = vehicle.position, vehicle.attitude
    if position is None or vehicle.position_age_s(now_s) > _FRESH_S:
        return False
    if attitude is None or vehicle.attitude_age_s(now_s) > _FRESH_S:
        return False
    speed = math.hypot(position.north_m_s, position.east_m_s, position.down_m_s)
    return speed < _RESTING_M_S and abs(attitude.yaw_rate_rad_s) < _RESTING_RAD_S


class SetpointHandover:
    """Knows when the vehicle can do without setpoints: after a hold, standing still.

    Attributes:
        done: no more setpoints are to be sent.
    """

    def __init__(self, settings: ReleaseSettings) -> None:
        self._wanted = settings.action is ReleaseAction.HAND_BACK
        self.done = False

    def step(
        self, state: SupervisorState, in_state_s: float, vehicle: VehicleState, now_s: float
    ) -> None:
        """Take the supervisor's state, how many seconds it lasts, and the vehicle's."""
        released = self._wanted and state is SupervisorState.RELEASED
        rests = in_state_s >= _HELD_S and is_resting(vehicle, now_s)
        self.done = released and (self.done or rests)


class Release:
    """Asks for the autopilot's own mode after a release, until telemetry shows it.

    The hold comes first: nothing is asked for before the vehicle rests, or could not within 4 s.
    Whoever takes another mode meanwhile has the vehicle, also who was back in ours when we heard of
    it; it is not asked for again. A pilot who took over is not asked at all.

    Args:
        settings: see there.
    """

    def __init__(self, settings: ReleaseSettings) -> None:
        self._settings = settings
        self._before = SupervisorState.IDLE
        self._entries = 0
        self._since_s: float | None = None
        self._asked_s = -math.inf
        self._asked = 0
        self._notes: list[str] = []

    @property
    def acts(self) -> bool:
        """Whether more than a hold follows on a release, and nobody has the vehicle yet."""
        return self._since_s is not None and self._settings.action is not ReleaseAction.HOLD

    def step(
        self,
        now_s: float,
        state: SupervisorState,
        reason: SupervisorReason,
        vehicle: VehicleState,
        autopilot_name: str,
    ) -> str | None:
        """Return the mode to ask for at `now_s` (seconds), None for none."""
        released, before, self._before = state is SupervisorState.RELEASED, self._before, state
        stayed, self._entries = vehicle.entries == self._entries, vehicle.entries
        is_ours = stayed and vehicle.obeys_setpoints and reason not in _TAKEOVERS
        if released and before.engaged and is_ours:
            self._since_s, self._asked_s, self._asked = now_s, -math.inf, 0
        if self._since_s is None:
            return None
        if not released or not is_ours:
            self._end(vehicle.mode)
            return None
        mode = release_mode(self._settings.action, autopilot_name)
        if mode is None:
            return None
        ready = is_resting(vehicle, now_s) or now_s - self._since_s >= _LONGEST_STOP_S
        due = now_s - self._asked_s >= self._settings.retry_s
        return self._ask(now_s, mode) if ready and due else None

    def take_notes(self) -> list[str]:
        """Return what happened since the last call, in words."""
        notes, self._notes = self._notes, []
        return notes

    def _ask(self, now_s: float, mode: str) -> str:
        self._asked_s = now_s
        self._asked += 1
        if self._asked == 1:
            self._notes.append(f"asking for {mode}")
        elif self._asked == _REFUSED_AFTER + 1:
            self._notes.append(f"{mode} is not entered: holding, and asking again")
        return mode

    def _end(self, mode: str) -> None:
        self._since_s = None
        if self._asked:
            self._notes.append(f"the autopilot is in {mode}")
