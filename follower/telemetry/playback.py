"""A log's telemetry as control would have had it, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from follower.telemetry.log import ModeChange, TelemetryLog
from follower_control.vehicle import Attitude, LocalPosition, VehicleState

_BEFORE_S = 1.0
_RECORDED = "recorded"

SampleT = TypeVar("SampleT", Attitude, LocalPosition, ModeChange)


class TelemetryPlayback:
    """Hands out telemetry in the order of time.

    Somebody else flew: the vehicle is taken to allow following all the time, whatever its mode was,
    and the link to have been alive.

    Args:
        log: with times on the clock of the video.
        start_s: what is older than a second before it is left out.
    """

    def __init__(self, log: TelemetryLog, start_s: float) -> None:
        oldest_s = start_s - _BEFORE_S
        self._attitudes = [one for one in log.attitudes if one.time_s >= oldest_s]
        self._positions = list(log.positions)
        self._modes = list(log.modes)
        self._state = VehicleState(mode=_RECORDED, obeys_setpoints=True, armed=True)

    def until(self, now_s: float) -> tuple[VehicleState, Sequence[Attitude]]:
        """Return the newest of everything at `now_s`, and the attitudes since the last call."""
        attitudes = _taken(self._attitudes, now_s)
        positions, modes = _taken(self._positions, now_s), _taken(self._modes, now_s)
        state = replace(self._state, heartbeat_s=now_s)
        if attitudes:
            state = replace(state, attitude=attitudes[-1])
        if positions:
            state = replace(state, position=positions[-1])
        if modes:
            state = replace(state, mode=modes[-1].mode or _RECORDED)
        self._state = state
        return state, attitudes


def _taken(samples: list[SampleT], now_s: float) -> list[SampleT]:
    """Take and return the samples up to `now_s`."""
    count = next((n for n, one in enumerate(samples) if one.time_s > now_s), len(samples))
    taken = samples[:count]
    del samples[:count]
    return taken
