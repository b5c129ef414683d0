"""Roofs that hide a target for so long from a vehicle that follows it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from follower_sim.kinematics import Triple
from follower_sim.paths import TargetPath
from follower_sim.scenario import OcclusionSettings, Scenario, SceneryItem, TargetSettings
from follower_sim.scenery import CANOPY_THICK_M
from follower_sim.targets import HEIGHTS_M
from follower_vision.camera import Vector

_PIECE_M = 3.0
_OVERLAP = 0.75
_LEAST_M = 0.5
_CLEAR_M = 9.0
_STEP_S = 0.05
_LONGEST_WAIT_S, _WAIT_S, _APART_S = 14.0, 0.25, 5.0
_NEAR_S, _FAST = 0.5, 0.4


def canopies(
    scenario: Scenario, followed: TargetSettings, path: TargetPath
) -> Iterator[SceneryItem]:
    """Yield the pieces of roof above what the target passes while it is to be hidden.

    None stands where the target waits at first, or it could not be pointed out.
    """
    settings, (north, east, _) = scenario.occlusions, path.pose(0.0).position_m
    if settings.hidden_s <= 0:
        return
    free_s = 0.0
    for number in range(settings.count):
        earliest_s = max(settings.first_s + number * settings.every_s, free_s)
        from_s = _when(path, earliest_s, settings.hidden_s)
        free_s = from_s + settings.hidden_s + _APART_S
        if settings.distance_m is None:
            line = _above(path, from_s, settings.hidden_s)
        else:
            line = _between(path, from_s, followed, settings, settings.distance_m)
        heading = path.pose(from_s).heading_rad
        for place, heading_rad, length_m in _pieces(line, heading):
            if math.dist(place[:2], (north, east)) > _CLEAR_M:
                yield _roof(place, heading_rad, length_m, followed, settings)


def _when(path: TargetPath, from_s: float, hidden_s: float) -> float:
    """Return the first time from then on at which it may be hidden for so long, and no longer.

    A target that stops at the edge of a roof is hidden for as long as it stands there.
    """
    waits = np.arange(0.0, _LONGEST_WAIT_S, _WAIT_S).tolist()
    fast = _FAST * max(_slowest(path, from_s + wait_s) for wait_s in waits)
    for start_s in (from_s + wait_s for wait_s in waits):
        if min(_slowest(path, start_s), _slowest(path, start_s + hidden_s)) >= fast:
            return float(start_s)
    return from_s


def _slowest(path: TargetPath, time_s: float) -> float:
    """Return the least speed thereabouts."""
    return min(
        math.hypot(*path.pose(time_s + near_s).velocity_m_s) for near_s in (-_NEAR_S, 0.0, _NEAR_S)
    )


def _above(path: TargetPath, from_s: float, hidden_s: float) -> Vector:
    """Return the way of the target while it is to be hidden, (N, 3) north, east, down."""
    first_m = path.pose(from_s).distance_m
    length_m = max(_LEAST_M, path.pose(from_s + hidden_s).distance_m - first_m)
    along_m = np.linspace(first_m, first_m + length_m, math.ceil(length_m / 0.1) + 1)
    return np.array([path.course.position(float(along)) for along in along_m])


def _between(
    path: TargetPath,
    from_s: float,
    followed: TargetSettings,
    settings: OcclusionSettings,
    distance_m: float,
) -> Vector:
    """Return where the lines of sight to the hidden target cross the roof, (N, 3).

    The vehicle that sees it has followed it up to then, and stands from then on: for one that
    goes on it is hidden for a shorter time. The near edge hides by its lower side, and the far one
    by its upper side.
    """
    down = math.radians(settings.down_deg)
    north, east, _ = follower_place(path, from_s, distance_m * math.cos(down))
    high_m, half_m = distance_m * math.sin(down), HEIGHTS_M[followed.kind] / 2
    times = np.arange(0.0, settings.hidden_s + _STEP_S, _STEP_S).clip(max=settings.hidden_s)
    places = np.array([path.pose(from_s + float(t)).position_m for t in times])
    above_m = half_m + settings.clearance_m + CANOPY_THICK_M * times / settings.hidden_s
    share = np.maximum(1 - above_m / high_m, 0.0)[:, None]
    eye = np.array([north, east])
    return np.column_stack([eye + share * (places[:, :2] - eye), places[:, 2]])


def follower_place(path: TargetPath, until_s: float, behind_m: float) -> Triple:
    """Return where one is who was drawn after the target on a string: north, east, target's down.

    A pursuer that flies along its nose moves like that: on a tractrix.
    """
    start = path.pose(0.0)
    east, north = math.sin(start.heading_rad), math.cos(start.heading_rad)
    place = complex(*start.position_m[:2]) - behind_m * complex(north, east)
    for time_s in np.arange(0.0, until_s + _STEP_S, _STEP_S).clip(max=until_s):
        target = complex(*path.pose(float(time_s)).position_m[:2])
        away = abs(target - place)
        if away > behind_m:
            place = target + (place - target) * behind_m / away
    return place.real, place.imag, path.pose(until_s).position_m[2]


def _pieces(line: Vector, heading_rad: float) -> Iterator[tuple[Triple, float, float]]:
    """Yield the middle of each piece along a line, its heading and its length.

    A line without a length gets a short piece in the direction that is given.
    """
    lengths = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1))]
    )
    length_m = max(_LEAST_M, float(lengths[-1]))
    count = max(1, math.ceil(length_m / (_PIECE_M * _OVERLAP)))
    step_m = length_m / count
    piece_m = step_m if count == 1 else step_m / _OVERLAP
    for number in range(count):
        ends = (number * step_m, (number + 0.5) * step_m, (number + 1) * step_m)
        first, middle, last = (_at(line, lengths, end) for end in ends)
        north, east = (float(x) for x in last[:2] - first[:2])
        stands = math.hypot(north, east) < _LEAST_M / 2
        turned = heading_rad if stands else math.atan2(east, north)
        yield (float(middle[0]), float(middle[1]), float(middle[2])), turned, piece_m


def _at(line: Vector, lengths: Vector, along_m: float) -> Vector:
    return np.array([np.interp(along_m, lengths, line[:, axis]) for axis in range(3)])


def _roof(
    place: Triple,
    heading_rad: float,
    length_m: float,
    followed: TargetSettings,
    settings: OcclusionSettings,
) -> SceneryItem:
    return SceneryItem(
        kind=settings.kind,
        at=place[:2],
        heading_deg=math.degrees(heading_rad),
        size_m=length_m,
        height_m=HEIGHTS_M[followed.kind] + settings.clearance_m - place[2],
    )
