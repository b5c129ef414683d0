"""Remembers where in the world the target's look-alikes are, also while nothing is seen of them.

What was seen beside the target is another thing, and stays one, however alike they look: what comes
out from behind a cover where a look-alike must be by now is that look-alike. Which of them is what
is asked of all at once, as in joint probabilistic data association (Fortmann, Bar-Shalom, Scheffe:
"Sonar tracking of multiple targets using joint probabilistic data association", 1983).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.fusion.candidates import corners_of
from follower_vision.geometry.box import Box, pairwise_iou
from follower_vision.geometry.camera_model import CameraView

Floats = npt.NDArray[np.floating]

_MOST = 6
_KEPT_S = 5.0
_KNOWN = 0.8
"""So often something has to be seen beside the target to be known as another thing."""
_SAME_IOU = 0.3
_RANGE_SHARE = 0.3
"""What a range by size may be wrong by: things turn, and boxes are cut."""
_BOX_SHARE = 0.1
_ANGLE_SHARE = 0.25
"""The rest of what directions may be wrong by is the same for all that is seen at a time."""
_MANOEUVRE = 1.5
"""Root of the spectral density of a look-alike's acceleration, m/s^1.5, as of the target's."""
_START_SPEED_M_S = 3.0
_ODDS_M2 = 20.0
"""So many times as probable is it that what is exactly where a look-alike must be is that one, than
that it is something new while that one is not to be seen, if its place is known to 1 m²."""
_GATE = 11.3
"""Squared Mahalanobis distance that 99 % of the true places lie within (three degrees)."""
_SAME = 3.0
"""So near to a look-alike's place, squared, is the target if that was the target."""


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Where in the world N boxes are, if they show things of the target's size.

    Attributes:
        places: (N, 3) north, east, down, metres.
        noise: (N, 3, 3) covariance of them.
        along_m: (N,) standard deviation along the line of sight.
    """

    places: Floats
    noise: Floats
    along_m: Floats

    @classmethod
    def of(cls, boxes: Sequence[Box], view: CameraView, size_px_m: float) -> Sightings:
        """Return where boxes are.

        Args:
            boxes: in pixels.
            view: how they were seen.
            size_px_m: the scale that the target's box has at 1 m, pixels times metres.
        """
        scales = np.array([box.scale for box in boxes])
        ranges = size_px_m / scales
        rays = view.directions([(box.cx, box.cy) for box in boxes])
        focal_px = math.sqrt(view.camera.fx * view.camera.fy)
        across = (_ANGLE_SHARE * view.angle_rad + _BOX_SHARE * scales / focal_px) * ranges
        along = _RANGE_SHARE * ranges
        outer = rays[:, :, None] * rays[:, None, :]
        noise = across[:, None, None] ** 2 * np.eye(3)
        noise = noise + (along**2 - across**2)[:, None, None] * outer
        return cls(view.place_m + ranges[:, None] * rays, noise, along)


@dataclass(slots=True, eq=False)
class _LookAlike:
    """A thing that moves steadily through the world.

    Attributes:
        state: (6,) place and velocity, metres and seconds.
        covariance: (6, 6).
        beside: how often it was seen beside the target, by the target's probability then.
        unseen_s: for how long it has not been seen.
        waits_s: for how long nobody has looked for it.
    """

    state: Floats
    covariance: Floats
    beside: float
    unseen_s: float = 0.0
    waits_s: float = 0.0

    @property
    def known(self) -> bool:
        """Whether it is something else for certain."""
        return self.beside >= _KNOWN

    def predict(self, interval_s: float) -> None:
        move = np.eye(6)
        move[:3, 3:] = interval_s * np.eye(3)
        density, t = _MANOEUVRE**2, interval_s
        drive = np.kron([[t**3 / 3, t**2 / 2], [t**2 / 2, t]], density * np.eye(3))
        self.state = move @ self.state
        self.covariance = move @ self.covariance @ move.T + drive
        self.unseen_s += interval_s
        self.waits_s += interval_s

    def observe(self, place: Floats, noise: Floats) -> None:
        gain = self.covariance[:, :3] @ np.linalg.inv(self.covariance[:3, :3] + noise)
        self.state = self.state + gain @ (place - self.state[:3])
        self.covariance = self.covariance - gain @ self.covariance[:3]
        self.unseen_s = 0.0

    def fit(self, seen: Sightings) -> tuple[Floats, Floats]:
        """Return N squared distances, and how much more probable each place is than anywhere."""
        spread = self.covariance[:3, :3] + seen.noise
        off = seen.places - self.state[:3]
        squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off)
        area = np.sqrt(np.linalg.det(spread)) / seen.along_m
        return squares, _ODDS_M2 / area * np.exp(-squares / 2)


class LookAlikes:
    """Tracks of the target's look-alikes in the world."""

    def __init__(self) -> None:
        self._tracks: list[_LookAlike] = []

    def predict(self, interval_s: float) -> None:
        """Go on by a time in seconds."""
        for one in self._tracks:
            one.predict(interval_s)
        self._tracks = [one for one in self._tracks if one.unseen_s < _KEPT_S]

    def sought(self, view: CameraView) -> tuple[tuple[float, float], float] | None:
        """Return where in an image the one should be that was not looked at for longest.

        Returns:
            its place in pixels, and how far off it is, metres; None if none is in the image.
        """
        for one in sorted(self._tracks, key=lambda each: -each.waits_s):
            away_m = one.state[:3] - view.place_m
            ahead_m = float(away_m @ view.turn[:, 2])
            x, y = view.pixels(away_m[None])[0].tolist()
            if ahead_m > 0 and 0 <= x < view.camera.width and 0 <= y < view.camera.height:
                one.waits_s = 0.0
                return (x, y), float(np.linalg.norm(away_m))
        return None

    def evidence(self, boxes: Sequence[Box], seen: Sightings) -> Floats:
        """Return what speaks against each of N boxes by who else it must be, (N,), in log odds.

        That is by how much worse all that is seen is explained if it is no look-alike.
        """
        known = [one for one in self._tracks if one.known]
        if not known or not boxes:
            return np.zeros(len(boxes))
        things = _things(boxes)
        weights = np.array([one.fit(seen)[1] for one in known])
        best = np.array([weights[:, things == k].max(axis=1) for k in range(things.max() + 1)])
        against = np.empty(len(boxes))
        for k in range(len(best)):
            rest = np.delete(best, k, axis=0)
            without = _explained(rest)
            for index in np.flatnonzero(things == k):
                whole = _explained(np.vstack([rest, weights[:, index]]))
                against[index] = math.log(whole / without)
        return against

    def update(self, seen: Sightings, target: float) -> None:
        """Take what the detector saw that is not the target.

        Args:
            seen: where it is.
            target: how probably the target was seen at the same time; 0 if it was not. Only then
                is it certain to be something else.
        """
        free = set(range(len(seen.places)))
        fits = [one.fit(seen) for one in self._tracks]
        for one, (_, weights) in zip(self._tracks, fits, strict=True):
            best = max(free, key=lambda k: float(weights[k]), default=None)
            if best is not None and weights[best] > 1.0:
                one.observe(seen.places[best], seen.noise[best])
                one.beside += target
                free.discard(best)
        known = [squares for squares, _ in fits]
        new = [k for k in sorted(free) if all(squares[k] > _GATE for squares in known)]
        self._tracks += [self._begun(seen, k, target) for k in new]
        self._tracks.sort(key=lambda one: (one.unseen_s, -one.beside))
        del self._tracks[_MOST:]

    def leave(self, target: Sightings) -> None:
        """Forget what may have been the target itself, which is here: `target` has one place."""
        self._tracks = [
            one for one in self._tracks if one.known or float(one.fit(target)[0][0]) > _SAME
        ]

    def _begun(self, seen: Sightings, k: int, target: float) -> _LookAlike:
        covariance = np.diag([0.0, 0.0, 0.0, *[_START_SPEED_M_S**2] * 3])
        covariance[:3, :3] = seen.noise[k]
        return _LookAlike(np.concatenate([seen.places[k], np.zeros(3)]), covariance, target)


def _things(boxes: Sequence[Box]) -> npt.NDArray[np.intp]:
    """Return of which thing each box is, (N,): what overlaps is one."""
    corners = corners_of(list(boxes))
    overlap = pairwise_iou(corners, corners) >= _SAME_IOU
    things = np.full(len(boxes), -1)
    for k in range(len(boxes)):
        if things[k] < 0:
            things[overlap[k] & (things < 0)] = things.max() + 1
    return things


def _explained(weights: Floats) -> float:
    """Return the sum over all ways in which K things are each of D look-alikes, or something new.

    Args:
        weights: (K, D), against 1 for something new.
    """
    # One axis a look-alike: 0 while it is none of the things so far, 1 once it is one of them.
    ways = np.zeros((2,) * weights.shape[1])
    ways.flat[0] = 1.0
    for row in weights:
        before = ways.copy()
        for number, weight in enumerate(row):
            left, taken = ((slice(None),) * number + (state,) for state in (0, 1))
            ways[taken] += weight * before[left]
    return float(ways.sum())
