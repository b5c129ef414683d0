"""Puts the autopilot's and the pilot's part of the faults into a simulated autopilot."""

from __future__ import annotations

from follower.faults.fault import Kind
from follower.faults.schedule import FaultSchedule
from follower_sim.autopilot import SimAutopilot
from follower_sim.firmware import ARDUCOPTER, PX4

PILOTS_MODE = {"px4": "POSCTL", "ardupilot": "LOITER"}
_FAILSAFE_MODE = {"px4": "LAND", "ardupilot": "LAND"}
_OTHERS = ("LOITER", "BRAKE", "RTL", "LAND")
_WELL, _BATTERY_PERCENT, _CENTRE_US = 0.1, 90.0, 1500.0
_SETPOINT_MODE = {"px4": PX4.setpoint_mode, "ardupilot": ARDUCOPTER.setpoint_mode}


class AutopilotFaults:
    """Throws a simulated autopilot's switches.

    Args:
        autopilot: whose.
        flavour: "px4" or "ardupilot".
        schedule: says what is on.
    """

    def __init__(self, autopilot: SimAutopilot, flavour: str, schedule: FaultSchedule) -> None:
        self._autopilot = autopilot
        self._flavour = flavour
        self._schedule = schedule
        self._done: set[Kind] = set()
        self._before_s: float | None = None
        self._lost_s = 0.0

    def apply(self, now_s: float) -> None:
        """Bring the switches to where they belong now."""
        faults = self._autopilot.faults
        faults.attitude_frozen = self._on(Kind.ATTITUDE_FROZEN, now_s)
        faults.position_frozen = self._on(Kind.POSITION_FROZEN, now_s)
        faults.telemetry_stopped = self._on(Kind.TELEMETRY_STOPPED, now_s)
        faults.attitude_nan = self._on(Kind.ATTITUDE_NAN, now_s)
        faults.position_nan = self._on(Kind.POSITION_NAN, now_s)
        faults.position_stopped = self._on(Kind.POSITION_STOPPED, now_s)
        faults.position_jump_m = self._amount(Kind.POSITION_JUMPS, now_s)
        faults.yaw_jump_rad = self._amount(Kind.YAW_JUMPS, now_s)
        faults.clock_jump_s = self._amount(Kind.CLOCK_JUMPS, now_s) - self._lost_time(now_s)
        faults.refuses_setpoints = self._on(Kind.MODE_REFUSED, now_s)
        faults.refused_modes = _OTHERS if self._on(Kind.OTHER_MODES_REFUSED, now_s) else ()
        self._autopilot.health.test_ratio = self._amount(Kind.ESTIMATOR_UNWELL, now_s, _WELL)
        self._autopilot.health.battery_percent = round(
            self._amount(Kind.BATTERY_LOW, now_s, _BATTERY_PERCENT)
        )
        if self._schedule.plans(Kind.STICK_MOVED):
            roll_us = round(self._amount(Kind.STICK_MOVED, now_s, _CENTRE_US))
            self._autopilot.move_sticks(roll_us, *(round(_CENTRE_US),) * 3)
        if self._begins(Kind.AUTOPILOT_RESTARTS, now_s):
            self._autopilot.restart()
        if self._begins(Kind.PILOT_SWITCHES, now_s):
            self._autopilot.switch_mode(PILOTS_MODE[self._flavour])
        if self._begins(Kind.PILOT_RETURNS, now_s):
            self._autopilot.switch_mode(_SETPOINT_MODE[self._flavour])
        if self._begins(Kind.ESTIMATOR_FAILSAFE, now_s):
            self._autopilot.switch_mode(_FAILSAFE_MODE[self._flavour])

    def _lost_time(self, now_s: float) -> float:
        """Return what the autopilot's clock has lost; it never makes up for it."""
        passed_s = 0.0 if self._before_s is None else now_s - self._before_s
        self._before_s = now_s
        self._lost_s += passed_s * self._amount(Kind.CLOCK_SLOW, now_s)
        return self._lost_s

    def _on(self, kind: Kind, now_s: float) -> bool:
        return self._schedule.active(kind, now_s) is not None

    def _amount(self, kind: Kind, now_s: float, otherwise: float = 0.0) -> float:
        action = self._schedule.active(kind, now_s)
        return otherwise if action is None else action.amount

    def _begins(self, kind: Kind, now_s: float) -> bool:
        if kind in self._done or self._schedule.begun(kind, now_s) is None:
            return False
        self._done.add(kind)
        return True
