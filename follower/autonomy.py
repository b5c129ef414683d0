"""Flying without a pilot, in the simulator alone: arm, take off, hand over, take back."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

from follower.links.link import Link
from follower.supervisor import State

_RETRY_S = 1.0
_REACHED_SHARE = 0.93
_SETTLED_M_S = 0.3


class Phase(StrEnum):
    """How far the flight has come."""

    CONNECTING = "connecting"
    ARMING = "arming"
    TAKING_OFF = "taking off"
    AIRBORNE = "airborne"
    FOLLOWING = "following"
    DONE = "done"


class Autonomy:
    """Plays the pilot: setting `autonomy: full` alone puts it in charge.

    Stepped beside the control loop. Each command is repeated once a second until telemetry shows
    its effect; nothing is believed by its acknowledgement.

    Attributes:
        phase: how far the flight has come.
        resumes: after letting go, take the mode again when the supervisor is ready again, because
            an operator consented anew.
    """

    def __init__(self, link: Link, takeoff_height_m: float) -> None:
        self._link = link
        self._height_m = takeoff_height_m
        self._asked_s = float("-inf")
        self._ground_down_m: float | None = None
        self.phase = Phase.CONNECTING
        self.resumes = False

    def step(self, now_s: float, state: State) -> None:
        """Do what the phase asks for; `state` is the supervisor's."""
        if state is State.RELEASED:
            self.phase = Phase.DONE
        elif self.resumes and self.phase is Phase.DONE and state is State.READY:
            self.phase = Phase.AIRBORNE
        actions: dict[Phase, Callable[[float], None]] = {
            Phase.CONNECTING: self._connect,
            Phase.ARMING: self._arm,
            Phase.TAKING_OFF: self._climb,
            Phase.DONE: self._finish,
        }
        if self.phase in actions:
            actions[self.phase](now_s)
        elif state is State.READY:
            self._ask(now_s, self._link.enter_setpoint_mode)
        elif state.engaged:
            self.phase = Phase.FOLLOWING

    def _connect(self, _now_s: float) -> None:
        vehicle = self._link.state
        ready = vehicle.position is not None and self._link.altitude_msl_m is not None
        if self._link.connected and vehicle.attitude is not None and ready:
            self.phase = Phase.ARMING

    def _arm(self, now_s: float) -> None:
        position = self._link.state.position
        if self._link.state.armed and position is not None:
            self._ground_down_m = position.down_m
            self.phase = Phase.TAKING_OFF
            return
        if self._link.autopilot_name == "ardupilot" and not self._link.state.obeys_setpoints:
            # ArduCopter takes off by command in GUIDED alone.
            self._ask(now_s, self._link.enter_setpoint_mode)
        else:
            self._ask(now_s, self._link.arm)

    def _climb(self, now_s: float) -> None:
        position = self._link.state.position
        if position is None or self._ground_down_m is None:
            return
        climbed_m = self._ground_down_m - position.down_m
        if climbed_m < 0.3:
            self._ask(now_s, lambda: self._link.take_off(self._height_m))
        if climbed_m > _REACHED_SHARE * self._height_m and abs(position.down_m_s) < _SETTLED_M_S:
            self.phase = Phase.AIRBORNE

    def _finish(self, now_s: float) -> None:
        if self._link.state.obeys_setpoints:
            self._ask(now_s, self._link.enter_hold_mode)

    def _ask(self, now_s: float, command: Callable[[], None]) -> None:
        if now_s - self._asked_s >= _RETRY_S:
            self._asked_s = now_s
            command()
