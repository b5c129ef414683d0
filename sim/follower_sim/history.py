"""The last seconds of a body's truth."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import deque

from follower_sim.angles import wrap
from follower_sim.kinematics import BodyState, Triple

_KEPT = 400


class History:
    """Newest states, oldest first, with a look-up between them.

    A camera's thread may look while the autopilot's adds.
    """

    def __init__(self, first: BodyState) -> None:
        self._states: deque[BodyState] = deque([first], maxlen=_KEPT)
        self._lock = threading.Lock()

    @property
    def newest(self) -> BodyState:
        """The last state added."""
        return self._states[-1]

    def add(self, state: BodyState) -> None:
        """Append a state later than all others; the oldest is forgotten."""
        with self._lock:
            self._states.append(state)

    def at(self, time_s: float) -> BodyState:
        """Return the state at a time, interpolated; outside what is kept, the nearest."""
        with self._lock:
            states = self._states
            if time_s >= states[-1].time_s:
                return states[-1]
            after = bisect_right(states, time_s, key=lambda state: state.time_s)
            a, b = states[max(after - 1, 0)], states[min(after, len(states) - 1)]
        return a if a is b else _between(a, b, time_s)


def _between(a: BodyState, b: BodyState, time_s: float) -> BodyState:
    share = (time_s - a.time_s) / (b.time_s - a.time_s)
    return BodyState(
        time_s,
        _mix(a.position_m, b.position_m, share),
        _mix(a.velocity_m_s, b.velocity_m_s, share),
        _mix_angles(a.attitude_rad, b.attitude_rad, share),
        _mix(a.rates_rad_s, b.rates_rad_s, share),
    )


def _mix(a: Triple, b: Triple, share: float) -> Triple:
    (x, y, z), (to_x, to_y, to_z) = a, b
    return x + (to_x - x) * share, y + (to_y - y) * share, z + (to_z - z) * share


def _mix_angles(a: Triple, b: Triple, share: float) -> Triple:
    x, y, z = (wrap(p + wrap(q - p) * share) for p, q in zip(a, b, strict=True))
    return x, y, z
