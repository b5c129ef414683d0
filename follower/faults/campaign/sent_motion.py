"""Acceleration and jerk of what is sent, from the packets alone."""

from __future__ import annotations

from follower.faults.evidence import WireSetpoint
from follower_control.envelope_settings import EnvelopeSettings

_SLACK_M_S2 = 0.01
"""Numbers on the wire have 32 bits: at 15 m/s and 50 Hz that is 0.0001 m/s2, and more of jerk."""


class SentMotion:
    """Differentiates the stream of set-points, once and twice.

    A zero may come at any time, and what follows one may be the vehicle's own velocity, with which
    following begins: there the differences begin anew.

    Args:
        limits: the envelope's.
    """

    def __init__(self, limits: EnvelopeSettings) -> None:
        self._limits = limits
        self._before: WireSetpoint | None = None
        self._acceleration: tuple[complex, float] | None = None

    def start(self) -> None:
        """Begin anew with the next set-point."""
        self._before = self._acceleration = None

    def failure(self, setpoint: WireSetpoint) -> str:
        """Say how a set-point departs too fast from those before it; "" if it does not."""
        before, self._before = self._before, setpoint
        if before is None or before.is_zero or setpoint.is_zero:
            self._acceleration = None
            return ""
        interval_s = min(setpoint.time_s - before.time_s, self._limits.max_interval_s)
        if interval_s <= 0:
            return ""
        past, self._acceleration = self._acceleration, _rate(before, setpoint, interval_s)
        level, upright = self._acceleration
        most = self._limits.max_acceleration_m_s2 + _SLACK_M_S2
        if max(abs(level), abs(upright)) > most:
            return f"an acceleration of {max(abs(level), abs(upright)):.2f} m/s2 is sent"
        if past is None:
            return ""
        change = max(abs(level - past[0]), abs(upright - past[1]))
        if change > self._limits.max_jerk_m_s3 * interval_s + _SLACK_M_S2:
            return f"a jerk of {change / interval_s:.1f} m/s3 is sent"
        return ""


def _rate(before: WireSetpoint, after: WireSetpoint, interval_s: float) -> tuple[complex, float]:
    """Return the horizontal acceleration, forward + 1j * right, and the one down."""
    a, b = before.values, after.values
    level = complex(b[0] - a[0], b[1] - a[1]) / interval_s
    return level, (b[2] - a[2]) / interval_s
