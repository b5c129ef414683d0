"""The offset between the autopilot's clock and ours."""

import math
import statistics
from collections import deque

_SLACK_S = 0.002
"""Times since boot are whole milliseconds."""
_BACK_S = 1.0
"""Messages overtake each other by less."""
_JUMP_S = 1.0
_PATIENCE = 5
"""So many contradictions in a row are believed."""
_PACED_S = 10.0
_WRAP_S = 2**32 / 1000
"""After 49.7 days times since boot in messages begin anew at 0; those in answers go on."""
_DRIFT, _LARGEST_DRIFT = 1e-4, 0.02
"""Crystals are right to 1e-5; simulated autopilots were seen to lose a second in a hundred."""


class AutopilotClock:
    """Maps an autopilot's time since boot to the system's clock.

    Causality bounds the offset from both sides: a message cannot arrive before it was sent, and
    an answer is given after its question left. The intersection of all such bounds holds the true
    offset whatever the delays and however unequal the two ways are (Marzullo and Owicki,
    "Maintaining the time in a distributed system", 1983); a slow packet is a loose bound and does
    no harm. The bounds relax with time, so that a crystal that runs wrong is followed.

    Bounds that contradict each other several times in a row mean that the autopilot was restarted,
    that its clock jumped, or that it runs at another speed than ours; a single one is a stray
    packet and is not believed. Answers and messages are counted each for themselves: a message
    bounds from one side only, and agrees with nearly everything. After answers have contradicted
    by less than a second, the bounds relax faster, and do so from then on, as for a simulation that
    loses time. That a message is late contradicts nothing, however late it is: a link that has
    become slow must not make old telemetry look new. A time since boot that goes back does.

    Attributes:
        restarts: how often the clock jumped by a second or more.
    """

    def __init__(self) -> None:
        self._drift = _DRIFT
        self._low_s, self._high_s = -math.inf, math.inf
        self._at_s = self._newest_boot_s = -math.inf
        self._strikes = {"message": 0, "answer": 0}
        self._first: tuple[float, float] | None = None
        self._last = (0.0, 0.0)
        self.restarts = 0

    @property
    def error_s(self) -> float | None:
        """The most by which a mapped time can be wrong, seconds; None before an exchange."""
        half = (self._high_s - self._low_s) / 2
        return half + _SLACK_S / 2 if math.isfinite(half) else None

    @property
    def pace(self) -> float | None:
        """Seconds that pass on its clock in one of ours, None before ten of ours have passed.

        A simulation that the computer is too slow for is far from 1.
        """
        if self._first is None or self._last[1] - self._first[1] < _PACED_S:
            return None
        return (self._last[0] - self._first[0]) / (self._last[1] - self._first[1])

    def to_system(self, boot_s: float, arrival_s: float) -> float:
        """Return when `boot_s` was on the system's clock, in seconds; never after its arrival."""
        boot_s = self._unwrapped(boot_s)
        self._bound(-math.inf, boot_s, arrival_s, "message")
        return min(boot_s + self._offset_s, arrival_s)

    def exchange(self, asked_s: float, boot_s: float, arrival_s: float) -> None:
        """Take in that a question of `asked_s` was answered at `boot_s` on the autopilot."""
        if self._first is None or boot_s < self._last[0]:
            self._first = boot_s, asked_s
        self._last = boot_s, asked_s
        self._bound(asked_s, boot_s, arrival_s, "answer")

    @property
    def _offset_s(self) -> float:
        if self._low_s == -math.inf:
            return self._high_s
        return (self._low_s + self._high_s) / 2

    def _unwrapped(self, boot_s: float) -> float:
        """Return the time since boot that a message means, by the newest one known."""
        if self._newest_boot_s == -math.inf:
            return boot_s
        return boot_s + _WRAP_S * round((self._newest_boot_s - boot_s) / _WRAP_S)

    def _bound(self, asked_s: float, boot_s: float, now_s: float, source: str) -> None:
        self._relax(now_s)
        low_s, high_s = asked_s - boot_s, now_s - boot_s
        if self._contradicts(low_s, high_s) or boot_s < self._newest_boot_s - _BACK_S:
            self._strikes[source] += 1
            if self._strikes[source] >= _PATIENCE:
                self._newest_boot_s = boot_s
                self._begin_anew(low_s, high_s)
            return
        self._strikes[source] = 0
        self._newest_boot_s = max(self._newest_boot_s, boot_s)
        self._low_s, self._high_s = max(self._low_s, low_s), min(self._high_s, high_s)
        if self._low_s > self._high_s:
            self._low_s = self._high_s = (self._low_s + self._high_s) / 2

    def _begin_anew(self, low_s: float, high_s: float) -> None:
        """Believe the newest bounds alone."""
        jumped_s = max(low_s - self._high_s, self._low_s - high_s, high_s - self._high_s)
        if jumped_s < _JUMP_S:
            self._drift = _LARGEST_DRIFT
        else:
            self.restarts += 1
        self._low_s, self._high_s = low_s, high_s
        self._strikes = dict.fromkeys(self._strikes, 0)

    def _relax(self, now_s: float) -> None:
        if now_s > self._at_s and self._at_s != -math.inf:
            grown = self._drift * (now_s - self._at_s)
            self._low_s, self._high_s = self._low_s - grown, self._high_s + grown
        self._at_s = max(self._at_s, now_s)

    def _contradicts(self, low_s: float, high_s: float) -> bool:
        too_early = high_s < self._low_s - _SLACK_S
        too_late = low_s > self._high_s + _SLACK_S
        return too_early or too_late


_MOST_OPEN = 20
_SHOWN = 10
_EARLY_S = 1e-3


class TimeSync:
    """Asks at a steady rate and gives the clock the bounds that the answers set.

    An answer counts once and only to a question of ours, so that late duplicates and inventions
    change nothing.

    Args:
        clock: takes the bounds.
        rate_hz: how often to ask, in Hz.
    """

    def __init__(self, clock: AutopilotClock, rate_hz: float) -> None:
        self._clock = clock
        self._period_s = 1.0 / rate_hz
        self._asked_s = float("-inf")
        self._open: dict[int, float] = {}
        self._round_trips_s: deque[float] = deque(maxlen=_SHOWN)

    @property
    def round_trip_s(self) -> float | None:
        """Median of the last ten round trips in seconds, with the wait for our next `poll`."""
        trips = tuple(self._round_trips_s)
        return statistics.median(trips) if trips else None

    def question(self, now_s: float) -> int | None:
        """Return the `ts1` (nanoseconds) of a question that is due now, None if none is."""
        if now_s - self._asked_s < self._period_s - _EARLY_S:
            return None
        self._asked_s = now_s
        stamp = time_ns(now_s)
        self._open[stamp] = now_s
        if len(self._open) > _MOST_OPEN:
            del self._open[next(iter(self._open))]
        return stamp

    def answer(self, tc1: int, ts1: int, now_s: float) -> bool:
        """Take an answer: the autopilot's time and our question, both in nanoseconds.

        Returns:
            whether it is one to a question of ours.
        """
        asked_s = self._open.pop(ts1, None)
        if asked_s is None or now_s < asked_s:
            return False
        self._round_trips_s.append(now_s - asked_s)
        self._clock.exchange(asked_s, tc1 / 1e9, now_s)
        return True


def time_ns(now_s: float) -> int:
    """Return a time as TIMESYNC carries it; never 0, which means a question."""
    return max(1, round(now_s * 1e9))
