"""Where the target is in the world, and how it moves there."""

from __future__ import annotations

import cmath
import copy
import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from follower_control.common.small_matrix import (
    clip,
    inverse_of_covariance,
    largest_eigenvalue,
    product,
    quadratic_form,
)
from follower_vision.geometry.camera_model import Vector

_START_SPEED_M_S = 3.0
_FAR_OFF = 25.0
"""A place with a larger squared Mahalanobis distance from the prediction is a new beginning."""

_ODD = 5.0
"""After a while unseen, a place with a squared distance larger than this is doubted until the
target was seen there for long enough. Of true places a sixth lies beyond (chi-square, three degrees
of freedom)."""

_WRONG_VELOCITY = 3
"""After so many such places in a row the velocity is not believed any more."""

TURN_FILTER_S, TURN_LASTS_S = 0.7, 2.0
"""Over how long it is watched how its course turns, and how long a turn is taken to last."""

_SLOW_S = 1.5
"""Within what time an error that lasts for seconds changes."""

_TURN_SURE_M_S, _FASTEST_TURN = 1.5, 1.0
_STEP_S = 0.25

_SIDEWAYS_M_S2, _WAYS = 2.5, 9
"""How hard a target that is not seen may turn, and how many ways to do so are looked at."""


_GONE_S, _PROVEN_S = 0.25, 0.8
"""After so long unseen it is asked whether a jump was true, and for so long it has to be seen there
to be so."""


_REMEMBERED_S, _EVERY_S = 4.0, 0.4
"""For how long it is remembered what was believed, and how often that is noted down."""


@dataclass(frozen=True, slots=True, eq=False)
class _Belief:
    state: Vector
    covariance: Vector
    time_s: float
    turn_rad_s: float


class TargetWorldFilter:
    """A Kalman filter on the target's place (north, east, down), for one that moves steadily.

    Its places are those of the world. So our own motion, which telemetry tells at once, never
    looks like the target's, however late the camera is.

    While nothing is seen of it, it is taken to go on as fast, and to turn on as it did, less and
    less.

    Args:
        acceleration_m_s2: how the target is expected to manoeuvre along the line of sight: the root
            of the spectral density of its acceleration, per sqrt(Hz).
        across_m_s2: the same across it; None: as along it.
    """

    def __init__(self, acceleration_m_s2: float, across_m_s2: float | None = None) -> None:
        self.change(acceleration_m_s2, across_m_s2)
        self.reset()

    def change(self, acceleration_m_s2: float, across_m_s2: float | None = None) -> None:
        """Go on with another expectation of how it manoeuvres."""
        across = acceleration_m_s2 if across_m_s2 is None else across_m_s2
        self._density, self._density_across = acceleration_m_s2**2, across**2

    def reset(self) -> None:
        """Forget the target."""
        self._time_s: float | None = None
        self._newest_s: float | None = None
        self._before: _Belief | None = None
        self._past: deque[_Belief] = deque()
        self._jumped_s = 0.0
        self._misses = 0
        self._turn_rad_s = 0.0
        self._state = np.zeros(7)
        self._covariance = np.zeros((7, 7))

    @property
    def time_s(self) -> float | None:
        """When it was seen last, as far as that is believed; None before that."""
        return self._time_s

    @property
    def newest_s(self) -> float | None:
        """The time of the last sighting, believed or not; None before that."""
        return self._newest_s

    def drop_unproven(self, now_s: float) -> None:
        """Take it to be where it was before it jumped, if it was seen there for a moment only.

        Something else that is taken for a hidden target is so for a moment, and far off.
        """
        if self._before is None or self._time_s is None or now_s - self._time_s <= _GONE_S:
            return
        before, self._before, self._misses = self._before, None, 0
        self._believe(before)
        while self._past and self._past[-1].time_s > before.time_s:
            self._past.pop()

    def observe(
        self,
        place_m: Vector,
        noise_m2: Vector,
        time_s: float,
        direction: Vector | None = None,
        slow_m: float = 0.0,
    ) -> None:
        """Take in where it was seen; what is not newer than before is left out.

        Args:
            place_m: (3,) north, east, down.
            noise_m2: 3x3 covariance of the place.
            time_s: when it was there.
            direction: (3,) of the line of sight, a unit vector; None: any.
            slow_m: standard deviation of an error along it that lasts for seconds.
        """
        slow = np.zeros(3) if direction is None else slow_m * direction
        if self._newest_s is not None and time_s <= self._newest_s:
            return
        self.drop_unproven(time_s)
        self._note(time_s)
        if self._time_s is None:
            self._begin(place_m, noise_m2, np.zeros(3), slow)
        else:
            if self._before is not None and time_s - self._jumped_s > _PROVEN_S:
                self._before = None
            self._fuse(place_m, noise_m2, time_s - self._time_s, direction, slow)
        self._time_s = self._newest_s = time_s

    def _note(self, now_s: float) -> None:
        """Note down now and then what is believed."""
        while self._past and now_s - self._past[0].time_s > _REMEMBERED_S:
            self._past.popleft()
        last_s = self._past[-1].time_s if self._past else -math.inf
        if self._time_s is not None and self._time_s - last_s >= _EVERY_S:
            self._past.append(self._believed(self._time_s))

    def _believed(self, time_s: float) -> _Belief:
        return _Belief(self._state.copy(), self._covariance, time_s, self._turn_rad_s)

    def earlier(self) -> Iterator[TargetWorldFilter]:
        """Yield it as it was believed to be in the last seconds, the latest first."""
        for belief in reversed(self._past):
            then = copy.copy(self)
            then._believe(belief)
            yield then

    def _believe(self, belief: _Belief) -> None:
        self._state, self._covariance = belief.state, belief.covariance
        self._time_s, self._turn_rad_s = belief.time_s, belief.turn_rad_s

    def at(self, time_s: float) -> tuple[Vector, Vector]:
        """Return its place and velocity, (3,) each, if it goes on as it did."""
        ahead_s = 0.0 if self._time_s is None else time_s - self._time_s
        place, velocity = self._state[:3], self._state[3:6]
        if ahead_s <= 0 or abs(velocity[0]) + abs(velocity[1]) == 0:
            return place + ahead_s * velocity, velocity
        count = math.ceil(ahead_s / _STEP_S)
        step_s = ahead_s / count
        for number in range(count):
            place = place + step_s * self._turned(velocity, (number + 0.5) * step_s)
        return place, self._turned(velocity, ahead_s)

    def _turned(self, velocity_m_s: Vector, after_s: float) -> Vector:
        """Return a velocity that has turned for some time, at a rate that fades away."""
        north, east, down = velocity_m_s.tolist()
        speed2 = north * north + east * east
        rate = self._turn_rad_s * speed2 / (speed2 + _TURN_SURE_M_S**2)
        turn = rate * TURN_LASTS_S * (1.0 - math.exp(-after_s / TURN_LASTS_S))
        c, s = math.cos(turn), math.sin(turn)
        return np.array([c * north - s * east, s * north + c * east, down])

    def might_be_m(self, time_s: float) -> Vector:
        """Return places (N, 3) among which it may be by then, going on, turning or slower.

        It is taken to turn steadily, as sharply as one of its speed may, to either side.
        """
        ahead_s = self._unseen_s(time_s)
        place, (north, east, down) = self._state[:3], self._state[3:6].tolist()
        speed = math.hypot(north, east)
        sharpest = min(_SIDEWAYS_M_S2 / max(speed, 1e-3), _FASTEST_TURN)
        moved = np.empty((_WAYS, 3))
        for number in range(_WAYS):
            half = ahead_s * sharpest * (number / (_WAYS - 1) - 0.5)
            c, s = math.cos(half), math.sin(half)
            # A chord of an arc is shorter than it, and points halfway.
            chord = ahead_s * (s / half if half else 1.0)
            moved[number] = chord * (north * c - east * s), chord * (north * s + east * c), 0.0
        moved[:, 2] = ahead_s * down
        return np.asarray(place + np.concatenate([moved, moved / 2]))

    def reach_m(self, time_s: float, deviations: float, acceleration_m_s2: float) -> float:
        """Return how far from `at` it can be: by what is not known of it, and how it manoeuvres.

        Args:
            time_s: when.
            deviations: so many standard deviations of what was seen count.
            acceleration_m_s2: how hard it may have braked, sped up or turned since then.
        """
        ahead_s = self._unseen_s(time_s)
        deviation_m = math.sqrt(max(largest_eigenvalue(self._spread(ahead_s)), 0.0))
        return deviations * deviation_m + acceleration_m_s2 * ahead_s**2 / 2

    def deviation_m(self, time_s: float, direction: Vector) -> float:
        """Return the standard deviation of its place then, along a unit vector, (3,).

        Nothing being seen, it grows with the time.
        """
        ahead_s = self._unseen_s(time_s)
        variance = quadratic_form(self._spread(ahead_s), direction)
        return math.sqrt(max(variance + self._density * ahead_s**3 / 3, 0.0))

    def _unseen_s(self, time_s: float) -> float:
        return 0.0 if self._time_s is None else max(time_s - self._time_s, 0.0)

    def _spread(self, ahead_s: float) -> Vector:
        """Return the 3x3 covariance of its place so much later, at a steady velocity."""
        c = self._covariance
        mixed = c[:3, 3:6] + c[3:6, :3]
        return np.asarray(c[:3, :3] + ahead_s * mixed + ahead_s**2 * c[3:6, 3:6])

    def rescale(self, from_m: Vector, factor: float) -> None:
        """Put it so many times as far from a place, in the same direction."""
        self._before = None
        self._past.clear()
        self._state[:3] = from_m + factor * (self._state[:3] - from_m)

    def _begin(self, place_m: Vector, noise_m2: Vector, velocity_m_s: Vector, slow: Vector) -> None:
        self._state = np.concatenate([place_m, velocity_m_s, [0.0]])
        self._covariance = np.zeros((7, 7))
        self._covariance[:3, :3] = noise_m2 + slow[:, None] * slow
        self._covariance[3:6, 3:6] = _START_SPEED_M_S**2 * np.eye(3)
        self._covariance[6, 6] = 1.0
        # What the first place has of that error is in the place that is believed.
        self._covariance[:3, 6] = self._covariance[6, :3] = -slow
        self._turn_rad_s = 0.0

    def _miss(self, place_m: Vector, noise_m2: Vector, elapsed_s: float, slow: Vector) -> None:
        """Begin anew with the velocity that was known; if that is wrong, with two places' own.

        A single place that is far off is two misses: there and back.
        """
        self._misses += 1
        self._doubt(elapsed_s)
        if self._misses < _WRONG_VELOCITY:
            self._begin(place_m, noise_m2, self._state[3:6], slow)
            return
        self._begin(place_m, noise_m2, (place_m - self._state[:3]) / elapsed_s, slow)
        self._covariance[:3, 3:6] = self._covariance[3:6, :3] = noise_m2 / elapsed_s
        self._covariance[3:6, 3:6] += 2 * noise_m2 / elapsed_s**2

    def _doubt(self, elapsed_s: float) -> None:
        """Keep what is believed until what comes instead is proven."""
        if self._before is None and self._time_s is not None:
            self._before = self._believed(self._time_s)
            self._jumped_s = self._time_s + elapsed_s

    def _fuse(
        self,
        place_m: Vector,
        noise_m2: Vector,
        elapsed_s: float,
        direction: Vector | None,
        slow: Vector,
    ) -> None:
        state, covariance = self._moved(elapsed_s, direction)
        # The place is seen, and with it so much of the slow error: H = (I, 0, slow).
        off = place_m - (state[:3] + slow * state[6])
        seen = covariance[:, :3] + covariance[:, 6:] * slow
        inverse = inverse_of_covariance(seen[:3] + slow[:, None] * seen[6] + noise_m2)
        distance2 = quadratic_form(inverse, off)
        if elapsed_s > _GONE_S and distance2 > _ODD:
            self._doubt(elapsed_s)
        if distance2 > _FAR_OFF:
            self._miss(place_m, noise_m2, elapsed_s, slow)
            return
        self._misses = 0
        gain = product(seen, inverse)
        left = covariance - product(gain, seen.T)
        before, self._state = self._state, state + product(gain, off[:, None])[:, 0]
        self._covariance = (left + left.T) / 2
        self._watch_turn(before[3:6], elapsed_s)

    def _moved(self, elapsed_s: float, direction: Vector | None) -> tuple[Vector, Vector]:
        """Return state and covariance after so long: F x, and F P F' + Q."""
        kept = math.exp(-elapsed_s / _SLOW_S)
        state, covariance = self._state.copy(), self._covariance.copy()
        state[:3] += elapsed_s * state[3:6]
        state[6] *= kept
        covariance[:3] += elapsed_s * covariance[3:6]
        covariance[6] *= kept
        covariance[:, :3] += elapsed_s * covariance[:, 3:6]
        covariance[:, 6] *= kept
        covariance[:6, :6] += self._drive(elapsed_s, direction)
        covariance[6, 6] += 1 - kept * kept
        return state, covariance

    def _watch_turn(self, before_m_s: Vector, elapsed_s: float) -> None:
        """Take in by how much its course has turned since the last sighting."""
        (north, east, _), (was_north, was_east, _) = self._state[3:6].tolist(), before_m_s.tolist()
        speed2 = max(north * north + east * east, _TURN_SURE_M_S**2)
        turned = (was_north * east - was_east * north) / speed2
        seen = clip(turned / elapsed_s, 10 * _FASTEST_TURN)
        share = 1.0 - math.exp(-elapsed_s / TURN_FILTER_S)
        turn = self._turn_rad_s + share * (seen - self._turn_rad_s)
        self._turn_rad_s = clip(turn, _FASTEST_TURN)

    def _drive(self, elapsed_s: float, direction: Vector | None) -> Vector:
        """Continuous white acceleration, integrated over the interval (Bar-Shalom, ch. 6.2)."""
        t = elapsed_s
        density = self._density * np.eye(3)
        if direction is not None and self._density_across != self._density:
            along = direction[:, None] * direction
            density = self._density * along + self._density_across * (np.eye(3) - along)
        drive = np.empty((6, 6))
        drive[:3, :3], drive[3:, 3:] = t**3 / 3 * density, t * density
        drive[:3, 3:] = drive[3:, :3] = t**2 / 2 * density
        return drive


def place_noise(direction: Vector, along_m: float, across_m: float) -> Vector:
    """Return the 3x3 covariance of a place that is seen in a direction, a unit vector."""
    along = direction[:, None] * direction
    return np.asarray(along_m**2 * along + across_m**2 * (np.eye(3) - along))


_UNDER_WAY_M_S = 1.0
"""A target that is slower has no course of its own; it keeps the one it had."""


class TargetMotion:
    """The target's horizontal velocity and its course; vectors are north + 1j * east.

    Args:
        filter_s: time constant of the velocity.
    """

    def __init__(self, filter_s: float) -> None:
        self.change(filter_s)
        self.start()

    def start(self) -> None:
        """Forget everything: there is no course before the target goes somewhere."""
        self._course_rad: float | None = None
        self.reset()

    def change(self, filter_s: float) -> None:
        """Go on with another time constant."""
        self._filter_s = filter_s

    def reset(self) -> None:
        """Forget the velocity; the course stays."""
        self._known = False
        self.velocity_m_s: complex = 0.0

    @property
    def course_rad(self) -> float | None:
        """Where the target goes, from north; where it went last if it stands; None before."""
        return self._course_rad

    def update(self, velocity_m_s: complex, interval_s: float) -> complex:
        """Return the target's velocity, smoothed.

        Args:
            velocity_m_s: as it is seen now.
            interval_s: since the last update; 0 changes nothing.
        """
        if not self._known:
            self.velocity_m_s, self._known = velocity_m_s, True
        elif interval_s > 0:
            share = interval_s / (interval_s + self._filter_s)
            self.velocity_m_s += share * (velocity_m_s - self.velocity_m_s)
        if abs(self.velocity_m_s) > _UNDER_WAY_M_S:
            self._course_rad = cmath.phase(self.velocity_m_s)
        return self.velocity_m_s
