"""What has to hold in every control step of every random flight."""

import math
from dataclasses import dataclass
from typing import TypeAlias

from follower.settings.settings import Settings
from follower.simulation.faults.setpoint_rules import (
    RELEASE_WITHIN_S,
    envelope_failure,
    jump_failure,
)
from follower.simulation.faults.wire_tap import WireSetpoint
from follower_control.envelope.settings import EnvelopeSettings

_SLACK = 0.01
"""Numbers on the wire have 32 bits: at 15 m/s and 50 Hz that is 0.0001 m/s2, and more of jerk."""
_Rates: TypeAlias = tuple[complex, float, float]
"""Horizontal acceleration, forward + 1j * right, and that down, m/s2; yaw acceleration, rad/s2."""


class SetpointDerivatives:
    """Differentiates the stream of setpoints, once and twice.

    A zero may come at any time, and what follows one may be the vehicle's own velocity, with which
    following begins: there the differences begin anew.
    """

    def __init__(self, limits: EnvelopeSettings) -> None:
        self._limits = limits
        self._before: WireSetpoint | None = None
        self._acceleration: _Rates | None = None
        self._max_yaw_acceleration = math.radians(limits.max_yaw_acceleration_deg_s2)
        yaw_jerk = limits.max_yaw_jerk_deg_s3
        self._max_yaw_jerk = math.inf if yaw_jerk is None else math.radians(yaw_jerk)

    def start(self) -> None:
        """Begin anew with the next setpoint."""
        self._before = self._acceleration = None

    def failure(self, setpoint: WireSetpoint) -> str:
        """Say how a setpoint departs too fast from those before it; "" if it does not."""
        before, self._before = self._before, setpoint
        if before is None or before.is_zero or setpoint.is_zero:
            self._acceleration = None
            return ""
        interval_s = min(setpoint.time_s - before.time_s, self._limits.max_interval_s)
        if interval_s <= 0:
            return ""
        past, self._acceleration = self._acceleration, _rate(before, setpoint, interval_s)
        level, upright, turn = map(abs, self._acceleration)
        if max(level, upright) > self._limits.max_acceleration_m_s2 + _SLACK:
            return f"an acceleration of {max(level, upright):.2f} m/s2 is sent"
        if turn > self._max_yaw_acceleration + _SLACK:
            return f"a yaw acceleration of {math.degrees(turn):.1f} deg/s2 is sent"
        return "" if past is None else self._jerk_failure(past, self._acceleration, interval_s)

    def _jerk_failure(self, past: _Rates, now: _Rates, interval_s: float) -> str:
        level, upright, turn = (abs(b - a) for a, b in zip(past, now, strict=True))
        if max(level, upright) > self._limits.max_jerk_m_s3 * interval_s + _SLACK:
            return f"a jerk of {max(level, upright) / interval_s:.1f} m/s3 is sent"
        if turn > self._max_yaw_jerk * interval_s + _SLACK:
            return f"a yaw jerk of {math.degrees(turn) / interval_s:.0f} deg/s3 is sent"
        return ""


def _rate(before: WireSetpoint, after: WireSetpoint, interval_s: float) -> _Rates:
    forward, right, down, turn = (
        (b - a) / interval_s for a, b in zip(before.values, after.values, strict=True)
    )
    return complex(forward, right), down, turn


_STEPS_TO_RELEASE = 2
"""A starved computer's next steps may come later: garbage can hide the heartbeat from the first."""
_BROKEN_OFF_S = 0.5
_GRACE_S = 0.1
_NOTICEABLE_M_S = 0.1
_FLOAT32 = 1e-5
"""Numbers on the wire have 32 bits."""


class InvariantError(AssertionError):
    """Something happened that never may."""


@dataclass(slots=True)
class InputAges:
    """The ages of what the follower steers by, as the watcher knows them, in seconds.

    Attributes:
        frame_age_s: since the capture of the newest frame that was handed to control.
        shown_age_s: since the capture of the newest one that shows the target.
        heartbeat_age_s: since the newest heartbeat that reached it.
        step_gap_s: since the control step before.
        telemetry_age_s: the older one of attitude and position, as the follower knows them.
        own_m_s: its own horizontal velocity by that telemetry: forward and right, None if unknown.
        steers: whether it flies by the target.
        allowed: what the control step let through: forward, right, down, yaw rate.
    """

    frame_age_s: float
    shown_age_s: float
    heartbeat_age_s: float
    step_gap_s: float
    telemetry_age_s: float
    own_m_s: complex | None
    steers: bool
    allowed: tuple[float, float, float, float]


class Invariants:
    """Watches the setpoints of one flight.

    Args:
        settings: the follower's; their limits are what is held against.
        own_mode: `custom_mode` of the mode that flies setpoints.
        begun_anew_by_mode: the pilot's mode alone may renew consent.

    Raises:
        InvariantError: by `check`: something is not as it must be.
    """

    def __init__(self, settings: Settings, own_mode: int, begun_anew_by_mode: bool) -> None:
        self._limits = settings.envelope
        self._patience = settings.supervisor
        acceleration, jerk = self._limits.max_acceleration_m_s2, self._limits.max_jerk_m_s3
        # Horizontally and vertically, what braking still adds that begins in full acceleration.
        self._grows_m_s = math.sqrt(2) * acceleration**2 / (2 * jerk) + _NOTICEABLE_M_S
        self._own_mode = own_mode
        self._by_mode = begun_anew_by_mode
        self._motion = SetpointDerivatives(self._limits)
        self._before: WireSetpoint | None = None
        self._in_own_mode = False
        self._heartbeat_s = -math.inf
        self._released_s = math.inf
        self._steps_since_release = 0
        self._flown = False
        self._blind_since_s: float | None = None
        self._blind_speed = 0.0
        self._stalled_s = 0.0
        self._braked_until_s = -math.inf
        self.longest_after_pilot_s = 0.0
        self.setpoints = 0

    def heartbeat(self, custom_mode: int, now_s: float) -> None:
        """Note that a heartbeat reached the follower at `now_s`, seconds on the flight's clock."""
        obeys = custom_mode == self._own_mode
        if self._in_own_mode and not obeys:
            self._released_s = min(self._released_s, now_s) if self._flown else math.inf
            self._steps_since_release = 0
        self._in_own_mode, self._heartbeat_s = obeys, now_s

    def consent(self) -> None:
        """Note that the operator gave consent anew."""
        self._released_s = math.inf
        self._flown = False

    def heartbeat_age_s(self, now_s: float) -> float:
        """Return for how many seconds no heartbeat reached the follower."""
        return now_s - self._heartbeat_s

    def check(
        self, setpoints: list[WireSetpoint], now_s: float, inputs: InputAges, engages: bool
    ) -> None:
        """Check the setpoints sent in one control step, at `now_s` seconds.

        Where following begins, the first setpoint is the vehicle's own velocity, whatever was
        sent before.
        """
        if engages:
            self._before = None
            self._motion.start()
        self._steps_since_release += math.isfinite(self._released_s)
        self._note_blindness(now_s, inputs)
        for setpoint in setpoints:
            self.setpoints += 1
            self._forget_a_broken_stream(setpoint)
            self._within_envelope(setpoint)
            self._of_this_step(setpoint, now_s, inputs)
            self._in_our_mode(setpoint)
            self._not_blind(setpoint, inputs)
            self._flown = self._flown or not setpoint.is_zero
            self._before = setpoint

    def _forget_a_broken_stream(self, setpoint: WireSetpoint) -> None:
        """Let a stream that was interrupted, as in PX4's failsafe, begin anew at a lower speed."""
        before = self._before
        if before is None or setpoint.time_s - before.time_s < _BROKEN_OFF_S:
            return
        if setpoint.speed_m_s <= before.speed_m_s:
            self._before = None
            self._motion.start()

    def _within_envelope(self, setpoint: WireSetpoint) -> None:
        before = self._before
        failure = (
            envelope_failure(setpoint, self._limits)
            or (before and jump_failure(before, setpoint, self._limits))
            or self._motion.failure(setpoint)
        )
        if failure:
            raise InvariantError(failure)

    def _of_this_step(self, setpoint: WireSetpoint, now_s: float, inputs: InputAges) -> None:
        """Nothing old is sent, and nothing is steered by old telemetry."""
        pairs = zip(setpoint.values, inputs.allowed, strict=True)
        same = all(abs(sent - allowed) <= _FLOAT32 for sent, allowed in pairs)
        if not setpoint.is_zero and not (same and setpoint.time_s == now_s):
            raise InvariantError("a velocity is sent that this step did not allow")
        if inputs.steers and inputs.telemetry_age_s > self._patience.telemetry_timeout_s:
            raise InvariantError(f"steering by telemetry of {inputs.telemetry_age_s:.2f} s ago")

    def _in_our_mode(self, setpoint: WireSetpoint) -> None:
        if setpoint.time_s > self._released_s + RELEASE_WITHIN_S:
            if not setpoint.is_zero and not self._by_mode:
                raise InvariantError("a velocity after the mode was left, without new consent")
            at_once = setpoint.is_zero and self._steps_since_release <= _STEPS_TO_RELEASE
            if not self._in_own_mode and not self._by_mode and not at_once:
                raise InvariantError("a setpoint in another mode")
        elif setpoint.time_s > self._released_s:
            self.longest_after_pilot_s = max(
                self.longest_after_pilot_s, setpoint.time_s - self._released_s
            )
        other_mode_s = setpoint.time_s - self._heartbeat_s
        if not self._in_own_mode and not setpoint.is_zero and other_mode_s > RELEASE_WITHIN_S:
            raise InvariantError("a velocity while the newest heartbeat has another mode")

    def _note_blindness(self, now_s: float, inputs: InputAges) -> None:
        """Note since when the follower has been without something that it needs."""
        p = self._patience
        blind = (
            inputs.frame_age_s > p.frame_timeout_s + _GRACE_S
            or inputs.shown_age_s > p.coast_s + p.frame_timeout_s + _GRACE_S
            or inputs.heartbeat_age_s > p.link_timeout_s + _GRACE_S
        )
        if not blind:
            self._blind_since_s = None
            self._stalled_s = 0.0
        elif self._blind_since_s is None:
            self._blind_since_s = now_s
            self._blind_speed = 0.0 if self._before is None else self._before.speed_m_s

    def _not_blind(self, setpoint: WireSetpoint, inputs: InputAges) -> None:
        """Without track or link the speed grows only where it brakes, as before a fence."""
        if self._blind_since_s is None:
            return
        speed, since_s = setpoint.speed_m_s, setpoint.time_s - self._blind_since_s
        if self._is_against(setpoint, inputs):
            self._blind_speed = max(self._blind_speed, speed)
            self._braked_until_s = setpoint.time_s
        if speed > self._blind_speed + self._grows_m_s:
            raise InvariantError(
                f"the speed grows to {speed:.2f} m/s, {since_s:.2f} s after the last good input"
            )
        # Nothing brakes while no step is done; then the autopilot's own time-out acts.
        self._stalled_s += max(inputs.step_gap_s - self._limits.max_interval_s, 0.0)
        longest_s = self._blind_speed / self._limits.braking_m_s2 + 2.0 + self._stalled_s
        ramps_s = setpoint.time_s - max(self._blind_since_s, self._braked_until_s)
        if ramps_s > longest_s and speed > 0.05:
            raise InvariantError(
                f"still {speed:.2f} m/s, {since_s:.2f} s after the last good input"
            )

    def _is_against(self, setpoint: WireSetpoint, inputs: InputAges) -> bool:
        """Whether it leads against the motion that fresh telemetry reports."""
        if inputs.own_m_s is None or inputs.telemetry_age_s > self._patience.telemetry_timeout_s:
            return False
        sent = complex(*setpoint.values[:2])
        return (sent * inputs.own_m_s.conjugate()).real < 0
