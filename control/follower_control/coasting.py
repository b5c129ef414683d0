"""How fast to fly after a target that was not seen for a moment."""

from __future__ import annotations

from dataclasses import replace

from follower_control.setpoint import VelocitySetpoint


def slowed(asked: VelocitySetpoint, unseen_s: float, coast_s: float) -> VelocitySetpoint:
    """Return a setpoint whose velocity falls smoothly to 0 over the second half of `coast_s`.

    The first half is for blinks: slowing down for each would make the pursuit fall back. The yaw
    rate stays, so that the target is looked for where it should be.

    Args:
        asked: what the servo wants of the predicted target.
        unseen_s: how long the target has not been seen.
        coast_s: how long that is borne.
    """
    x = min(max(2 * unseen_s / coast_s - 1, 0.0), 1.0)
    left = 1 - x * x * (3 - 2 * x)
    return replace(
        asked,
        forward_m_s=left * asked.forward_m_s,
        right_m_s=left * asked.right_m_s,
        down_m_s=left * asked.down_m_s,
    )
