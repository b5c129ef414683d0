"""Messages that are sent again and again, as often as somebody asked."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

_FASTEST_S = 0.02
_SLOWEST_US = 2e9
"""MESSAGE_INTERVAL tells it in 32 bits with a sign."""
_STOP, _USUAL = -1.0, 0.0


class Streams:
    """The intervals of messages.

    Args:
        usual_s: each message that can be had, and its usual interval.
    """

    def __init__(self, usual_s: Mapping[int, float]) -> None:
        self._usual_s = dict(usual_s)
        self._interval_s: dict[int, float] = {}
        self._sent_s: dict[int, float] = {}

    def set(self, message_id: int, interval_us: float) -> bool:
        """Take an interval as MAV_CMD_SET_MESSAGE_INTERVAL gives it; whether it could be."""
        usual_s = self._usual_s.get(message_id)
        if usual_s is None or not math.isfinite(interval_us):
            return False
        if interval_us == _STOP:
            self._interval_s.pop(message_id, None)
            return True
        if not 0 <= interval_us <= _SLOWEST_US:
            return False
        wanted_s = usual_s if interval_us == _USUAL else interval_us / 1e6
        self._interval_s[message_id] = max(wanted_s, _FASTEST_S)
        return True

    def interval_us(self, message_id: int) -> int:
        """Return the interval as MESSAGE_INTERVAL tells it: -1 is never, 0 cannot be had."""
        if message_id not in self._usual_s:
            return 0
        interval_s = self._interval_s.get(message_id)
        return -1 if interval_s is None else round(1e6 * interval_s)

    def due(self, now_s: float) -> Iterator[int]:
        """Give the messages that are to be sent now."""
        for message_id, interval_s in list(self._interval_s.items()):
            # Half a wait of the thread early is nearer to the rate than half a wait late.
            if now_s - self._sent_s.get(message_id, -math.inf) >= 0.95 * interval_s:
                self._sent_s[message_id] = now_s
                yield message_id
