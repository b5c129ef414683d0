"""Whether vision kept up with the camera in real time."""

from __future__ import annotations

import numpy as np

from follower.flightlog import FlightLog

_FEWEST = 0.8
_LONGEST_S = 0.3


def said_of_late_frames(log: FlightLog, camera_hz: float) -> str | None:
    """Return a remark on a flight in which frames came late, None if they did not.

    Args:
        log: of the flight.
        camera_hz: frames a second that the camera takes.
    """
    captured_s = np.array([record.captured_s for record in log.tracks])
    if len(captured_s) < 2:
        return None
    seen_hz = (len(captured_s) - 1) / float(captured_s[-1] - captured_s[0])
    gap_s = float(np.diff(captured_s).max())
    if seen_hz >= _FEWEST * camera_hz and gap_s <= _LONGEST_S:
        return None
    return (
        f"Frames came late: vision saw {seen_hz:.0f} of the camera's {camera_hz:.0f} frames a "
        f"second, with gaps of up to {gap_s:.1f} s. This computer is too slow or too busy for real "
        "time; --lockstep does not depend on it."
    )
