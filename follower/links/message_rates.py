"""Asks for messages at their rates, and again when they do not come."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass

_WINDOW_S = 2.0
_FIRST_WAIT_S = 3.0
_LONGEST_WAIT_S = 30.0
_ENOUGH = 0.4
"""Share of the wanted rate that will do: ArduCopter gives 50 Hz of 100 on some links."""


@dataclass(frozen=True, slots=True)
class MessageRate:
    """One message: how often it is wanted, and how often it comes."""

    name: str
    wanted_hz: float
    measured_hz: float

    @property
    def is_enough(self) -> bool:
        """Whether it comes often enough to fly with."""
        return self.measured_hz >= _ENOUGH * self.wanted_hz


class MessageRates:
    """Counts messages over two seconds and says which ones to ask for.

    What stays slow is asked for again after 3 s, then 6 s, up to every 30 s.

    Args:
        wanted_hz: by message name.
        optional: names of messages that not every vehicle has: nothing is said if they are slow.
    """

    def __init__(self, wanted_hz: Mapping[str, float], optional: Collection[str] = ()) -> None:
        self._wanted_hz = dict(wanted_hz)
        self._optional = frozenset(optional)
        self._arrivals: dict[str, deque[float]] = {name: deque() for name in wanted_hz}
        self._ask_s = dict.fromkeys(wanted_hz, float("-inf"))
        self._wait_s = dict.fromkeys(wanted_hz, _FIRST_WAIT_S)
        self._next_ask_s = float("-inf")
        self._asked: set[str] = set()
        self._slow: set[str] = set()

    def want(self, name: str, rate_hz: float) -> None:
        """Have one more message asked for."""
        if name not in self._wanted_hz:
            self._arrivals[name] = deque()
            self._ask_s[name] = float("-inf")
            self._wait_s[name] = _FIRST_WAIT_S
            self._wanted_hz[name] = rate_hz
            self._next_ask_s = float("-inf")

    def ask_anew(self) -> None:
        """Have everything asked for at once: the autopilot may have been restarted."""
        self._ask_s = dict.fromkeys(self._wanted_hz, float("-inf"))
        self._wait_s = dict.fromkeys(self._wanted_hz, _FIRST_WAIT_S)
        self._next_ask_s = float("-inf")
        self._asked.clear()

    def count(self, name: str, now_s: float) -> None:
        """Count one message."""
        arrivals = self._arrivals.get(name)
        if arrivals is not None:
            arrivals.append(now_s)
            while arrivals[0] <= now_s - _WINDOW_S:
                arrivals.popleft()

    def measured(self, now_s: float) -> tuple[MessageRate, ...]:
        """Return all rates over the last two seconds; may be called from any thread."""
        return tuple(
            MessageRate(name, wanted, _rate_hz(tuple(self._arrivals[name]), now_s))
            for name, wanted in tuple(self._wanted_hz.items())
        )

    def due(self, now_s: float) -> tuple[MessageRate, ...]:
        """Return what is to be asked for now: all at first, then what comes too seldom."""
        if now_s < self._next_ask_s:
            return ()
        asks = [rate for rate in self.measured(now_s) if now_s >= self._ask_s[rate.name]]
        due = [rate for rate in asks if not rate.is_enough or rate.name not in self._asked]
        for rate in asks:
            slow = rate in due and rate.name in self._asked
            wait_s = min(2 * self._wait_s[rate.name], _LONGEST_WAIT_S) if slow else _FIRST_WAIT_S
            self._wait_s[rate.name] = wait_s
            self._ask_s[rate.name] = now_s + (wait_s if rate in due else _WINDOW_S / 2)
        self._next_ask_s = min(self._ask_s.values(), default=float("inf"))
        self._asked.update(rate.name for rate in due)
        return tuple(due)

    def changes(self, now_s: float) -> list[str]:
        """Return in words which messages became too slow or well again since the last call."""
        said: list[str] = []
        for name, wanted_hz in self._wanted_hz.items():
            if name in self._optional or self._is_enough(name, now_s) != (name in self._slow):
                continue
            rate = MessageRate(name, wanted_hz, _rate_hz(self._arrivals[name], now_s))
            if rate.is_enough:
                self._slow.discard(name)
                said.append(f"{name} comes at {rate.measured_hz:.0f} Hz again")
            elif name in self._asked and now_s > self._ask_s[name] - _WINDOW_S / 2:
                self._slow.add(name)
                said.append(
                    f"{name} comes at {rate.measured_hz:.1f} Hz, not at {wanted_hz:.0f}; "
                    "asking again"
                )
        return said

    def _is_enough(self, name: str, now_s: float) -> bool:
        """Whether a message comes often enough; at 50 Hz, without a look at each arrival."""
        arrivals = self._arrivals[name]
        while arrivals and arrivals[0] <= now_s - _WINDOW_S:
            arrivals.popleft()
        return len(arrivals) / _WINDOW_S >= _ENOUGH * self._wanted_hz[name]


def _rate_hz(arrivals: Collection[float], now_s: float) -> float:
    return sum(arrival > now_s - _WINDOW_S for arrival in arrivals) / _WINDOW_S
