"""Finds sensors whose values are stuck, and values that cannot be."""

import math
from dataclasses import replace

from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState

_MOVING_M_S = 0.3
_SENT_M = 2.0
_FASTEST_M_S = 200.0
"""No multirotor flies faster. The vehicle's path is added up from its velocities: a single absurd
one would displace it for good."""
REPEATS = 5
"""After so many repetitions in a row a sensor is not waited for any longer: it hangs."""


class StuckSensorDetector:
    """How long attitudes have not changed, whatever time stamps they come with.

    A stream may go on while what feeds it has hung. A real attitude has noise: it never comes twice
    with the same six numbers. At 50 of them a second a hang is known after a tenth of a second.
    """

    def __init__(self) -> None:
        self._numbers: tuple[float, ...] | None = None
        self._changed_s = -math.inf
        self._repeats = 0

    def note(self, attitude: Attitude, now_s: float) -> None:
        """Take a new attitude that has arrived."""
        if attitude.numbers != self._numbers:
            self._numbers, self._changed_s, self._repeats = attitude.numbers, now_s, 0
        else:
            self._repeats += 1

    def age_s(self, now_s: float) -> float:
        """Return for how many seconds the numbers have been the same.

        Infinity before the first, and where they have been repeated too often to be waited for.
        """
        return math.inf if self._repeats >= REPEATS else now_s - self._changed_s


class StuckPositionDetector:
    """How long positions have contradicted themselves.

    One that stays the same to the last bit while it reports a velocity is fed by nobody, and so is
    one that stays the same while the vehicle is sent metres away; that is believed again when it
    changes. One that reports standing still may else be the same for long: it may be measured
    coarsely.
    """

    def __init__(self) -> None:
        self._last: LocalPosition | None = None
        self._moved_s = -math.inf
        self._repeats = 0
        self._sent_m = 0.0

    def note(self, position: LocalPosition | None, now_s: float, sent_m: float = 0.0) -> None:
        """Take the newest position, the same one again if there is no newer.

        Args:
            position: the newest.
            now_s: the time.
            sent_m: how far setpoints that are flown have sent the vehicle since the last call.
        """
        last, self._last = self._last, position
        self._sent_m += sent_m
        if position is None or position == last:  # no `is`: a replay reads each anew
            return
        if last is None or last.numbers != position.numbers:
            self._sent_m = 0.0
        if self._sent_m > _SENT_M:
            self._repeats = REPEATS
        elif last is None or not _is_stuck(last, position):
            self._moved_s, self._repeats = now_s, 0
        else:
            self._repeats += 1

    def age_s(self, now_s: float) -> float:
        """Return for how many seconds no credible position has arrived.

        Infinity before the first, and where one has been repeated too often to be waited for.
        """
        return math.inf if self._repeats >= REPEATS else now_s - self._moved_s


def _is_stuck(last: LocalPosition, position: LocalPosition) -> bool:
    moves = math.hypot(position.north_m_s, position.east_m_s, position.down_m_s) > _MOVING_M_S
    return moves and last.numbers == position.numbers


class PlausibleTelemetryFilter:
    """Puts the last finite attitude and position in the place of those with NaN or infinity.

    A position with a velocity that no vehicle has is replaced likewise. They keep their time, and
    so grow old as if nothing had come.
    """

    def __init__(self) -> None:
        self._attitude: Attitude | None = None
        self._position: LocalPosition | None = None

    def of(self, vehicle: VehicleState) -> VehicleState:
        """Return the state with nothing in it that is not finite, or cannot be."""
        attitude, position = vehicle.attitude, vehicle.position
        if attitude is not self._attitude and (attitude is None or attitude.is_finite):
            self._attitude = attitude
        if position is not self._position and (position is None or _can_be(position)):
            self._position = position
        if vehicle.attitude is self._attitude and vehicle.position is self._position:
            return vehicle
        return replace(vehicle, attitude=self._attitude, position=self._position)


def _can_be(position: LocalPosition) -> bool:
    return position.is_finite and math.hypot(*position.numbers[3:]) <= _FASTEST_M_S
