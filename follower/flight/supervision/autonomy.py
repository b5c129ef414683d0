"""Flying without a pilot, in the simulator alone: arm, take off, hand over, take back."""

from collections.abc import Callable
from enum import StrEnum

from follower.flight.supervision.supervisor import SupervisorState
from follower.links.link import Link
from follower_control.vehicle.state import LocalPosition, VehicleState

_RETRY_S = 1.0
_REACHED_SHARE = 0.93
_SETTLED_M_S = 0.3
_ON_GROUND_M = 0.3
_IN_THE_AIR_M = 2.0
_HOVERS_S, _TELLS_LANDED_S = 1.0, 3.0
"""Without motion up or down it hovers after the first; the second is for an autopilot that does not
say whether an armed vehicle stands on the ground."""


class AutonomyPhase(StrEnum):
    """How far the flight has come."""

    CONNECTING = "connecting"
    ARMING = "arming"
    TAKING_OFF = "taking off"
    AIRBORNE = "airborne"
    FOLLOWING = "following"
    DONE = "done"

    @property
    def takes_off(self) -> bool:
        """Whether the take-off is still to come, or not over."""
        return self in (AutonomyPhase.CONNECTING, AutonomyPhase.ARMING, AutonomyPhase.TAKING_OFF)


class Autonomy:
    """Plays the pilot: setting `autonomy: full` alone puts it in charge.

    Stepped beside the control loop. Each command is repeated once a second until telemetry shows
    its effect; nothing is believed by its acknowledgement. A vehicle that is in the air already is
    taken over at the height at which it hovers: neither autopilot takes off from there, ArduCopter
    refuses and PX4 would climb as much again.

    Attributes:
        phase: how far the flight has come.
        resumes: after a release, take the mode again when the supervisor is ready again, because
            an operator consented anew.
    """

    def __init__(self, link: Link, takeoff_height_m: float) -> None:
        self._link = link
        self._height_m = takeoff_height_m
        self._asked_s = float("-inf")
        self._ground_down_m: float | None = None
        self._still_since_s: float | None = None
        self.phase = AutonomyPhase.CONNECTING
        self.resumes = False

    def step(self, now_s: float, state: SupervisorState) -> None:
        """Do what the phase asks for; `state` is the supervisor's."""
        if state is SupervisorState.RELEASED:
            self.phase = AutonomyPhase.DONE
        elif self.resumes and self.phase is AutonomyPhase.DONE and state is SupervisorState.READY:
            self.phase = AutonomyPhase.AIRBORNE
        actions: dict[AutonomyPhase, Callable[[float], None]] = {
            AutonomyPhase.CONNECTING: self._connect,
            AutonomyPhase.ARMING: self._arm,
            AutonomyPhase.TAKING_OFF: self._climb,
            AutonomyPhase.DONE: self._finish,
        }
        if self.phase in actions:
            actions[self.phase](now_s)
        elif state is SupervisorState.READY:
            self._ask(now_s, self._link.enter_setpoint_mode)
        elif state.engaged:
            self.phase = AutonomyPhase.FOLLOWING

    def _connect(self, _now_s: float) -> None:
        vehicle = self._link.state
        ready = vehicle.position is not None and self._link.altitude_msl_m is not None
        if self._link.connected and vehicle.attitude is not None and ready:
            self.phase = AutonomyPhase.ARMING

    def _arm(self, now_s: float) -> None:
        vehicle = self._link.state
        if vehicle.armed and vehicle.position is not None:
            self._leave_ground(vehicle, vehicle.position, now_s)
            return
        self._still_since_s = None
        if self._link.autopilot_name == "ardupilot" and not vehicle.obeys_setpoints:
            # ArduCopter takes off by command in GUIDED alone.
            self._ask(now_s, self._link.enter_setpoint_mode)
        else:
            self._ask(now_s, self._link.arm)

    def _leave_ground(self, vehicle: VehicleState, position: LocalPosition, now_s: float) -> None:
        """Take off with an armed vehicle, unless it flies already."""
        moves = abs(position.down_m_s) >= _SETTLED_M_S
        if self._still_since_s is None or moves:
            self._still_since_s = now_s
        still_s = now_s - self._still_since_s
        if vehicle.landed is None and still_s < _TELLS_LANDED_S:
            return
        flies = position.height_m > _IN_THE_AIR_M if vehicle.landed is None else not vehicle.landed
        if flies and still_s < _HOVERS_S:
            return  # it may be landing, or climb by somebody else's command
        self._ground_down_m = position.down_m
        self.phase = AutonomyPhase.AIRBORNE if flies else AutonomyPhase.TAKING_OFF

    def _climb(self, now_s: float) -> None:
        position = self._link.state.position
        if not self._link.state.armed:
            # What is armed and does not take off disarms by itself.
            self.phase = AutonomyPhase.ARMING
            return
        if position is None or self._ground_down_m is None:
            return
        climbed_m = self._ground_down_m - position.down_m
        if climbed_m < _ON_GROUND_M:
            self._ask(now_s, lambda: self._link.take_off(self._height_m))
        if climbed_m > _REACHED_SHARE * self._height_m and abs(position.down_m_s) < _SETTLED_M_S:
            self.phase = AutonomyPhase.AIRBORNE

    def _finish(self, now_s: float) -> None:
        if self._link.state.obeys_setpoints:
            self._ask(now_s, self._link.enter_hold_mode)

    def _ask(self, now_s: float, command: Callable[[], None]) -> None:
        if now_s - self._asked_s >= _RETRY_S:
            self._asked_s = now_s
            command()
