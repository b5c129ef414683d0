"""One number for how badly a run went: what an optimiser makes small."""

from __future__ import annotations

from follower.campaign.figures import Figures

_NOT_FOLLOWED = 20.0
_VIOLATION = 5.0


def cost(figures: Figures) -> float:
    """Return a run's cost.

    The line-of-sight error over 3 degrees, occlusions left out, and the range error over 12 %
    count once each, time out of the frame ten times, a late second of re-acquisition half;
    smoothness a little, so that of two settings that follow as well, the quieter one is cheaper. A
    broken limit costs 5, not to follow at all 20.
    """
    if figures.line_of_sight_box_rms_seen_deg is None or figures.approach_s is None:
        return _NOT_FOLLOWED
    total = figures.line_of_sight_box_rms_seen_deg / 3 + (figures.range_error_median or 0.0) / 0.12
    total += 10 * (1 - (figures.in_frame_share or 0.0))
    waits = [3.0 if took is None else min(took, 3.0) for took in figures.reacquired_s]
    total += 0.5 * sum(waits) / max(1, len(waits))
    total += 0.2 * (figures.acceleration_rms_m_s2 or 0.0)
    total += 0.005 * (figures.yaw_acceleration_rms_deg_s2 or 0.0)
    return total + _VIOLATION * (figures.envelope_violations + figures.is_too_near)
