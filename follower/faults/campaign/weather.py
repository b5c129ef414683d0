"""Random faults, on and off, one draw after the other."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from follower.faults.fault import Action, Kind

_LINK = {
    Kind.LINK_DOWN: (0.02, 0.05, 6.0, (0.0, 0.0)),
    Kind.PACKETS_LOST: (0.03, 0.5, 10.0, (0.02, 0.6)),
    Kind.PACKETS_DOUBLED: (0.02, 0.5, 10.0, (0.1, 1.0)),
    Kind.PACKETS_REORDERED: (0.02, 0.5, 10.0, (0.05, 0.5)),
    Kind.TELEMETRY_LATE: (0.02, 0.5, 6.0, (0.02, 1.5)),
    Kind.GARBAGE: (0.02, 0.5, 6.0, (0.0, 0.0)),
    Kind.STRANGERS: (0.02, 0.5, 6.0, (0.0, 0.0)),
    Kind.FUZZED: (0.02, 0.5, 6.0, (0.0, 0.0)),
}
_TELEMETRY = {
    Kind.ATTITUDE_FROZEN: (0.02, 0.1, 5.0, (0.0, 0.0)),
    Kind.POSITION_FROZEN: (0.02, 0.1, 5.0, (0.0, 0.0)),
    Kind.TELEMETRY_STOPPED: (0.02, 0.1, 5.0, (0.0, 0.0)),
    Kind.ATTITUDE_NAN: (0.02, 0.05, 4.0, (0.0, 0.0)),
    Kind.POSITION_NAN: (0.02, 0.05, 4.0, (0.0, 0.0)),
    Kind.POSITION_JUMPS: (0.02, 0.05, 4.0, (-500.0, 500.0)),
    Kind.YAW_JUMPS: (0.02, 0.05, 4.0, (-3.0, 3.0)),
    Kind.CLOCK_JUMPS: (0.02, 0.5, 8.0, (-30.0, 30.0)),
}
_VISION = {
    Kind.VISION_HANGS: (0.03, 0.1, 5.0, (0.0, 0.0)),
    Kind.VISION_SLOW: (0.02, 1.0, 8.0, (0.1, 0.8)),
    Kind.FRAMES_SILENT: (0.03, 0.1, 4.0, (0.0, 0.0)),
    Kind.FRAMES_LATE: (0.02, 0.5, 5.0, (0.05, 1.5)),
    Kind.FRAMES_REORDERED: (0.02, 0.5, 5.0, (0.0, 0.0)),
    Kind.FRAMES_BLACK: (0.05, 0.1, 6.0, (0.0, 0.0)),
    Kind.FRAMES_FROZEN: (0.02, 0.1, 5.0, (0.0, 0.0)),
}
_COMPUTER = {
    Kind.CONTROL_STARVED: (0.02, 0.5, 4.0, (0.02, 0.6)),
    Kind.CONTROL_STALLS: (0.01, 0.1, 3.0, (0.0, 0.0)),
}
TABLE = {**_LINK, **_TELEMETRY, **_VISION, **_COMPUTER}
"""By kind: how often it begins, 1/s; shortest and longest in seconds; range of the amount."""


class Weather:
    """What is on at present; asked like a `FaultSchedule`.

    Args:
        rng: draws.
        calm_s: nothing before this time.
        intensity: multiplies how often things begin.
    """

    def __init__(self, rng: np.random.Generator, calm_s: float, intensity: float) -> None:
        self._rng = rng
        self._kinds = tuple(TABLE)
        rates = np.array([TABLE[kind][0] for kind in self._kinds])
        self._shares = rates / rates.sum()
        self._mean_s = 1.0 / (intensity * float(rates.sum()))
        self._next_s = calm_s + float(rng.exponential(self._mean_s))
        self._on: dict[Kind, Action] = {}
        self._until_s: dict[Kind, float] = {}
        self.counts: dict[str, int] = {}

    def step(self, now_s: float) -> None:
        """Begin and end what is due."""
        for kind in [kind for kind, until_s in self._until_s.items() if until_s <= now_s]:
            del self._on[kind], self._until_s[kind]
        while self._next_s <= now_s:
            self._begin(self._kinds[int(self._rng.choice(len(self._kinds), p=self._shares))], now_s)
            self._next_s += float(self._rng.exponential(self._mean_s))

    def active(self, kind: Kind, now_s: float) -> Action | None:  # noqa: ARG002
        """Return the action of this kind that is on, None if none is."""
        return self._on.get(kind)

    def end_of(self, kind: Kind, now_s: float) -> float:
        """Return when the action of this kind that is on will be over; now, if none is."""
        return self._until_s.get(kind, now_s)

    def _begin(self, kind: Kind, now_s: float) -> None:
        _, shortest, longest, (low, high) = TABLE[kind]
        if kind not in self._on:
            for_s = math.exp(self._rng.uniform(math.log(shortest), math.log(longest)))
            amount = float(self._rng.uniform(low, high))
            self._on[kind], self._until_s[kind] = Action(kind, amount), now_s + for_s
            self.counts[kind.value] = self.counts.get(kind.value, 0) + 1


class Distortion:
    """Falsifies telemetry as the weather says; see `CheapVehicle.distort`."""

    def __init__(self, weather: Weather) -> None:
        self._weather = weather
        self._frozen: dict[str, Any] = {}
        self._changes: dict[str, Callable[[Any], Any]] = {
            "ATTITUDE": self._attitude,
            "LOCAL_POSITION_NED": self._position,
        }

    def __call__(self, message: Any) -> Any:
        """Return what is sent in the message's place, None for nothing."""
        change = self._changes.get(message.get_type())
        if change is None:
            return message
        if self._weather.active(Kind.TELEMETRY_STOPPED, 0.0) is not None:
            return None
        jump = self._weather.active(Kind.CLOCK_JUMPS, 0.0)
        if jump is not None:
            ahead_ms = int(1000.0 * jump.amount)
            message.time_boot_ms = max(0, message.time_boot_ms + ahead_ms)
        return change(message)

    def _attitude(self, m: Any) -> Any:
        jump = self._weather.active(Kind.YAW_JUMPS, 0.0)
        if jump is not None:
            m.yaw = math.remainder(m.yaw + jump.amount, math.tau)
        names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
        return self._stuck(m, names, Kind.ATTITUDE_FROZEN, Kind.ATTITUDE_NAN)

    def _position(self, m: Any) -> Any:
        jump = self._weather.active(Kind.POSITION_JUMPS, 0.0)
        if jump is not None:
            m.x += jump.amount
        names = ("x", "y", "z", "vx", "vy", "vz")
        return self._stuck(m, names, Kind.POSITION_FROZEN, Kind.POSITION_NAN)

    def _stuck(self, m: Any, names: tuple[str, ...], frozen: Kind, nan: Kind) -> Any:
        kind = m.get_type()
        if self._weather.active(frozen, 0.0) is not None and kind in self._frozen:
            for name, value in self._frozen[kind].items():
                setattr(m, name, value)
        else:
            self._frozen[kind] = {name: getattr(m, name) for name in names}
        if self._weather.active(nan, 0.0) is not None:
            for name in names:
                setattr(m, name, math.nan)
        return m
