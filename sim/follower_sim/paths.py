"""Where a target is at any time: a course driven at a speed profile."""

from __future__ import annotations

import math
from dataclasses import dataclass

from follower_sim.course import Course
from follower_sim.kinematics import Triple
from follower_sim.speed_profile import SpeedProfile

_KEPT = 16
"""So many poses are kept: one step asks for the same few again and again."""


@dataclass(frozen=True, slots=True)
class TargetPose:
    """A target's reference point (where it touches the ground) at one time.

    Attributes:
        position_m: (north, east, down).
        velocity_m_s: (north, east, down).
        heading_rad: from north, clockwise seen from above.
        distance_m: how far it has travelled; moves legs and rotors.
    """

    position_m: Triple
    velocity_m_s: Triple
    heading_rad: float
    distance_m: float


class TargetPath:
    """A course and a speed profile: pose in closed form at any time."""

    def __init__(self, course: Course, speeds: SpeedProfile) -> None:
        self.course = course
        self._speeds = speeds
        self._newest: dict[float, TargetPose] = {}

    def pose(self, time_s: float) -> TargetPose:
        """Return the pose; at the end of an open course the target stands."""
        pose = self._newest.get(time_s)
        if pose is None:
            if len(self._newest) >= _KEPT:
                self._newest.clear()
            self._newest[time_s] = pose = self._pose(time_s)
        return pose

    def _pose(self, time_s: float) -> TargetPose:
        distance = self._speeds.distance_m(time_s)
        speed = self._speeds.speed_m_s(time_s)
        if not self.course.closed and distance >= self.course.length_m:
            speed = 0.0
        place, tangent = self.course.at(distance)
        north, east, down = tangent
        heading = math.atan2(east, north)
        return TargetPose(place, (north * speed, east * speed, down * speed), heading, distance)

    def shortfall_m(self, until_s: float) -> float:
        """Return by how much the speeds drive past the course's end until `until_s`."""
        if self.course.closed:
            return 0.0
        return max(0.0, self._speeds.distance_m(until_s) - self.course.length_m)
