"""What becomes of the vehicle once we let go and the pilot does not take it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar

from follower.supervisor import State
from follower_control.vehicle import VehicleState

_RESTING_M_S, _RESTING_RAD_S = 0.3, 0.1
_LONGEST_STOP_S = 4.0
_FRESH_S = 0.5
_HELD_S = 1.0
_REFUSED_AFTER = 3


class ReleaseAction(StrEnum):
    """What follows on the hold with which every release begins."""

    HOLD = "hold"
    """Zero setpoints, until the pilot takes another mode."""
    LOITER = "loiter"
    """PX4's Hold, ArduCopter's BRAKE: its LOITER would sink with a throttle that is down."""
    RTL = "rtl"
    LAND = "land"
    HAND_BACK = "hand_back"
    """Standing still, no more setpoints. ArduCopter stays where it is, in GUIDED; PX4 goes into the
    failsafe that COM_OBL_RC_ACT chooses: without RC and with its default it flew home."""


@dataclass(frozen=True, slots=True)
class ReleaseSettings:
    """What becomes of the vehicle after letting go.

    Everything but "hold" and "hand_back" changes the autopilot's mode, which nothing else does.

    Attributes:
        action: see there.
        retry_s: how long to wait for a mode before asking for it again.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    action: ReleaseAction = ReleaseAction.HOLD
    retry_s: float = 1.0

    def __post_init__(self) -> None:
        if not 0.1 <= self.retry_s <= 60:
            raise ValueError(f"retry_s lies between 0.1 and 60 s, not {self.retry_s}")


def release_mode(action: ReleaseAction, autopilot_name: str) -> str | None:
    """Return the autopilot's own mode for an action, None if it needs none."""
    if action is ReleaseAction.LOITER:
        return "LOITER" if autopilot_name == "px4" else "BRAKE"
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


class HandBack:
    """Knows when the vehicle can do without setpoints: after a hold, standing still.

    Attributes:
        done: no more setpoints are to be sent.
    """

    def __init__(self, settings: ReleaseSettings) -> None:
        self._wanted = settings.action is ReleaseAction.HAND_BACK
        self.done = False

    def step(self, state: State, in_state_s: float, vehicle: VehicleState, now_s: float) -> None:
        """Look at the supervisor's state and the vehicle."""
        released = self._wanted and state is State.RELEASED
        rests = in_state_s >= _HELD_S and is_resting(vehicle, now_s)
        self.done = released and (self.done or rests)


class Release:
    """Asks for the autopilot's own mode after letting go, until telemetry shows it.

    The hold comes first: nothing is asked for before the vehicle rests, or could not within 4 s.
    Whoever takes another mode meanwhile has the vehicle; it is not asked for again.

    Args:
        settings: see there.
    """

    def __init__(self, settings: ReleaseSettings) -> None:
        self._settings = settings
        self._before = State.IDLE
        self._since_s: float | None = None
        self._asked_s = -math.inf
        self._asked = 0
        self._notes: list[str] = []

    @property
    def acts(self) -> bool:
        """Whether more than a hold follows on a release, and nobody has the vehicle yet."""
        return self._since_s is not None and self._settings.action is not ReleaseAction.HOLD

    def step(
        self, now_s: float, state: State, vehicle: VehicleState, autopilot_name: str
    ) -> str | None:
        """Return the mode to ask for now, None for none."""
        begins = state is State.RELEASED and self._before.engaged and vehicle.obeys_setpoints
        self._before = state
        if begins:
            self._since_s, self._asked_s, self._asked = now_s, -math.inf, 0
        if self._since_s is None:
            return None
        if state is not State.RELEASED or not vehicle.obeys_setpoints:
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
