"""When a stream's pictures were taken, on our clock, by the stream's own time stamps."""

import math
from collections import deque

_WINDOW_S = 4.0
_RECENT_S = 1.0
_MOST_S = 0.25
_TICK_S = 1e-6


class StreamClock:
    """Puts the time stamps of one stream on our clock.

    A camera stamps its pictures evenly; network, USB and computer deliver them unevenly, and never
    too early. So the two clocks differ by the least delay seen in the last seconds, and what a
    picture took longer than that was spent on the way. The window follows clocks that drift.

    A stream whose stamps run at a wrong rate, as where a sender counts pictures, would fall behind
    without end: a picture is never taken for more than 0.25 s older than its arrival less the least
    delay of the last second. Stamps that are missing, stand still or run backwards begin anew.
    """

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()
        self._stream_s = -math.inf
        self._captured_s = -math.inf

    def captured_s(self, stream_s: float | None, arrival_s: float) -> float:
        """Return a time after the picture before's, and not after its arrival.

        Two pictures of one arrival are a microsecond apart.

        Args:
            stream_s: the picture's time stamp, s; its zero is arbitrary. None if it has none.
            arrival_s: when it came, on our clock.
        """
        captured_s = arrival_s if stream_s is None else self._on_line(stream_s, arrival_s)
        self._captured_s = max(captured_s, self._captured_s + _TICK_S)
        return self._captured_s

    def _on_line(self, stream_s: float, arrival_s: float) -> float:
        if not stream_s > self._stream_s:
            self._delays.clear()
        self._stream_s = stream_s
        self._delays.append((arrival_s, arrival_s - stream_s))
        while self._delays[0][0] < arrival_s - _WINDOW_S:
            self._delays.popleft()
        least = min(delay for _, delay in self._delays)
        recent = min(delay for time_s, delay in self._delays if time_s >= arrival_s - _RECENT_S)
        return stream_s + max(least, recent - _MOST_S)
