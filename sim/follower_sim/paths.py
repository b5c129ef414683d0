"""Where a target is at any time: a course driven at a speed profile."""

from __future__ import annotations

import math
from dataclasses import dataclass

from follower_sim.course import Course
from follower_sim.kinematics import Triple
from follower_sim.speed_profile import SpeedProfile


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
        self._newest: tuple[float, TargetPose] | None = None

    def pose(self, time_s: float) -> TargetPose:
        """Return the pose; at the end of an open course the target stands."""
        newest = self._newest
        if newest is None or newest[0] != time_s:
            self._newest = newest = time_s, self._pose(time_s)
        return newest[1]

    def _pose(self, time_s: float) -> TargetPose:
        distance = self._speeds.distance_m(time_s)
        speed = self._speeds.speed_m_s(time_s)
        if not self.course.closed and distance >= self.course.length_m:
            speed = 0.0
        north, east, down = (float(x) for x in self.course.position(distance))
        tangent = self.course.direction(distance)
        v_north, v_east, v_down = (float(x) * speed for x in tangent)
        heading = math.atan2(float(tangent[1]), float(tangent[0]))
        return TargetPose((north, east, down), (v_north, v_east, v_down), heading, distance)

    def shortfall_m(self, until_s: float) -> float:
        """Return by how much the speeds drive past the course's end until `until_s`."""
        if self.course.closed:
            return 0.0
        return max(0.0, self._speeds.distance_m(until_s) - self.course.length_m)
