"""What the servo sees of a pursuit: distance, errors, and how the target moves."""

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from follower_control.common.small_matrix import clip, length
from follower_control.servo.output_blend import NO_OFFSET, StickOffset
from follower_control.servo.settings import FollowMode, RangeFrom, ServoSettings
from follower_control.target.estimate import (
    OLD_S,
    TargetEstimate,
    azimuth_of,
    ranged_by_ground,
    reproject,
    seen_again,
)
from follower_control.target.image_prediction import PredictedRegion
from follower_control.target.observation import BearingFrame, SizeMemory
from follower_control.target.world_filter import TargetMotion, TargetWorldFilter, place_noise
from follower_control.vehicle.history import PositionHistory
from follower_control.vehicle.state import VehicleState
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import wrap_angle


@dataclass(frozen=True, slots=True)
class ServoErrors:
    """What the servo saw of the pursuit at its last update, for logs and displays.

    Attributes:
        azimuth_rad: target right of the nose is positive.
        elevation_rad: target above where it is wanted is positive.
        log_range: logarithm of the range over the wanted range; too far is positive.
        range_m: distance to the target, as good as `target_size_m` is.
        target_speed_m_s: the target's own speed away from us; 0 without telemetry.
        range_deviation_m: standard deviation of `range_m`.
        is_level: whether the target's size agrees with the range by the ground, if that counts.
    """

    azimuth_rad: float
    elevation_rad: float
    log_range: float
    range_m: float
    target_speed_m_s: float
    range_deviation_m: float = 0.0
    is_level: bool = True

    @property
    def least_range_m(self) -> float:
        """The distance, taken to be a standard deviation less: what it is safe to count on."""
        return max(self.range_m - self.range_deviation_m, 0.0)

    @property
    def sure_speed_m_s(self) -> float:
        """The target's speed away from us as far as it is safe to count on.

        On ground that rises a target seems to run away, for its distance seems to grow.
        """
        return self.target_speed_m_s if self.is_level else min(self.target_speed_m_s, 0.0)


DISTANCE_M_S = 2.0
ANGLE_RAD_S = math.radians(15)
SIDE_M_S2 = 1.5
"""How fast a stick offset takes effect, and how fast it is taken back."""

_NEAREST_SHARE = 0.25
_STEEPEST_RAD = math.radians(85)


class Reference:
    """Follows stick offsets smoothly.

    Without an offset it is what the settings say, to the last bit.

    Args:
        distance_m: wanted distance. An offset brings it down to a quarter of this at most.
        elevation_rad: wanted elevation of the target.

    Attributes:
        distance_m: wanted now.
        elevation_rad: wanted now.
        azimuth_rad: where the target is wanted, right of the nose.
        side_m_s: wanted velocity around the target, to the right.
    """

    def __init__(self, distance_m: float, elevation_rad: float) -> None:
        self._distance_m, self._elevation_rad = distance_m, elevation_rad
        self._offset = NO_OFFSET
        self.start()

    def start(self) -> None:
        """Begin without any offset."""
        self.distance_m = self._distance_m
        self.elevation_rad = self._elevation_rad
        self.azimuth_rad = self.side_m_s = 0.0

    def change(self, distance_m: float, elevation_rad: float) -> None:
        """Go on towards another distance and elevation, as smoothly as after an offset."""
        self._distance_m, self._elevation_rad = distance_m, elevation_rad

    def set_offset(self, offset: StickOffset) -> None:
        """Go on towards this shift; one with a number that is not finite is no shift."""
        self._offset = offset if offset.is_finite else NO_OFFSET

    def step(self, interval_s: float) -> None:
        """Let so much time pass."""
        turn = ANGLE_RAD_S * interval_s
        nearest = _NEAREST_SHARE * self._distance_m
        distance = max(self._distance_m + self._offset.distance_m, nearest)
        elevation = clip(self._elevation_rad + self._offset.elevation_rad, self._steepest)
        azimuth = clip(self._offset.azimuth_rad, _STEEPEST_RAD)
        self.distance_m = _towards(self.distance_m, distance, DISTANCE_M_S * interval_s)
        self.elevation_rad = _towards(self.elevation_rad, elevation, turn)
        self.azimuth_rad = _towards(self.azimuth_rad, azimuth, turn)
        self.side_m_s = _towards(self.side_m_s, self._offset.side_m_s, SIDE_M_S2 * interval_s)

    @property
    def _steepest(self) -> float:
        return max(_STEEPEST_RAD, abs(self._elevation_rad))


def _towards(present: float, wanted: float, reach: float) -> float:
    return (
        wanted
        if abs(wanted - present) <= reach
        else present + math.copysign(reach, wanted - present)
    )


_LOG_TEN, _LOG_THOUSAND = math.log(10), math.log(1000)
_STRAIGHT_DOWN_RAD = -math.pi / 2

SIZE_ERROR = 0.08
"""By what share a range by size is usually wrong, and for seconds: measured of trackers' boxes."""

ACROSS, ALONG, ALONG_GROUND = 0.005, 0.03, 0.05
"""Standard deviations of a place as shares of the distance: across the line of sight, along it by
size, and along the ground."""

_FORESEEN_S = 6.0
_LIKELY, _POSSIBLE = (1.0, 2.0), (3.0, 3.5)
"""Where an unseen target is looked for, and where it can be at all: by how many standard deviations
of what was seen of it, and by how many m/s² it may have changed its velocity since."""

_NEAREST_M = 0.5
"""What is said to be nearer than this is so far away, for ratios of distances."""

_LARGER = 1.25
"""So much larger a target may look than it is; if more, the ground is not level, and the target
nearer than it says."""


class PursuitState:
    """Compares estimates with what is wanted, and keeps the target's size and motion.

    With telemetry, the target is kept as a place in the world that moves steadily: what is told of
    it for now is that place seen from where we are now. Our own motion since the frame was taken
    is thereby known, and never mistaken for the target's.

    Args:
        settings: of the servo.
        reference: what is wanted now.

    Attributes:
        target: where the target goes.
    """

    def __init__(self, settings: ServoSettings, reference: Reference) -> None:
        self._settings = settings
        self._told_m = settings.distance_m
        self._reference = reference
        self.target = TargetMotion(settings.course_filter_s)
        self._own = PositionHistory()
        self._moving = TargetWorldFilter(
            settings.target_acceleration_m_s2, settings.target_acceleration_across_m_s2
        )
        self._known = SizeMemory()
        self.start()

    def start(self) -> None:
        """Begin a pursuit; without a `target_size_m`, the size that `hold_size` sees will count."""
        s = self._settings
        self._wanted_log_scale: float | None = None
        self._known.reset()
        if s.target_size_m is not None:
            self._wanted_log_scale = math.log(s.target_size_m / s.distance_m)
            self._known.set(s.target_size_m)
        self.target.start()
        self._forget()

    def change(self, settings: ServoSettings) -> None:
        """Go on by other settings; a size that is held stays as far away as it was."""
        size_m, before = self._size_m, self._settings
        self._settings = settings
        by_size = settings.range_from is RangeFrom.SIZE
        if settings.target_size_m is not None:
            self._wanted_log_scale = math.log(settings.target_size_m / settings.distance_m)
            self._known.set(settings.target_size_m)
        elif by_size and before.range_from is RangeFrom.GROUND and self._known.log_m is not None:
            self._wanted_log_scale = self._known.log_m - math.log(settings.distance_m)
        elif self._wanted_log_scale is not None:
            self._wanted_log_scale += math.log(before.distance_m / settings.distance_m)
        if by_size and before.range_from is RangeFrom.SIZE:
            self._rescale(size_m)
        self._moving.change(
            settings.target_acceleration_m_s2, settings.target_acceleration_across_m_s2
        )
        self.target.change(settings.course_filter_s)

    @property
    def _size_m(self) -> float | None:
        """The size that the target is taken to have."""
        if self._wanted_log_scale is None:
            return None
        return self._settings.distance_m * math.exp(self._wanted_log_scale)

    def _rescale(self, size_m: float | None) -> None:
        """Put a target that was taken to have another size so many times as far away."""
        if self._here_m is not None and size_m is not None and self._size_m is not None:
            self._moving.rescale(self._here_m, self._size_m / size_m)

    def _forget(self) -> None:
        """Forget where the target is and how it moves."""
        self._moving.reset()
        self._here_m: Vector | None = None
        self._velocity_m_s: Vector | None = None
        self._by_ground, self._nearer = False, 1.0
        self.target.reset()

    def hold_size(self, estimate: TargetEstimate) -> None:
        """Take this size for the wanted one, unless there is one.

        The target is then as far away as it was said to be before the flight, or nearer: a
        distance that is raised in flight must not make the target seem farther away.
        """
        if self._wanted_log_scale is None:
            distance_m = self._settings.distance_m
            nearer = math.log(min(self._told_m, distance_m) / distance_m)
            self._wanted_log_scale = estimate.log_scale + nearer

    def world_estimate(self, estimate: TargetEstimate, vehicle: VehicleState) -> TargetEstimate:
        """Return what is known of the target now, by its motion in the world and our own.

        Without telemetry, and in the body's frame, that is the estimate itself.
        """
        position = vehicle.position
        fresh = vehicle.position_age_s(estimate.time_s) <= OLD_S
        if position is None or not fresh or estimate.frame is BearingFrame.BODY:
            self._own.clear()
            self._forget()
            return estimate
        if not self._own.add(position):
            self._forget()
        here = self._own.at(estimate.time_s)
        if here is None:
            return self._ranged(estimate, vehicle, 0.0)[0]
        self._watch(estimate, vehicle, here)
        self._moving.drop_unproven(estimate.time_s)
        place, velocity = self._moving.at(estimate.time_s)
        size_m = self._size_m
        if self._moving.time_s is None or size_m is None:
            return self._ranged(estimate, vehicle, 0.0)[0]
        self._here_m, self._velocity_m_s = here, velocity
        own = np.array(position.numbers[3:])
        return reproject(estimate, place - here, velocity - own, size_m)

    @property
    def knows_motion(self) -> bool:
        """Whether the target's motion in the world is known."""
        return self._velocity_m_s is not None

    @property
    def is_by_ground(self) -> bool:
        """Whether the target's motion in the world is known, by a distance by the ground."""
        return self._by_ground and self.knows_motion

    def possible_bearings(self, vehicle: VehicleState, now_s: float) -> Vector | None:
        """Return azimuths from north under which an unseen target may be by now; None if unknown.

        They spread with the time since it was seen, about the one of where it went.
        """
        position = vehicle.position
        if position is None or vehicle.position_age_s(now_s) > OLD_S or self._moving.time_s is None:
            return None
        if not self._own.add(position):
            self._forget()
            return None
        here = self._own.at(now_s)
        if here is None:
            return None
        self._moving.drop_unproven(now_s)
        away = self._moving.might_be_m(now_s) - here
        return np.array([math.atan2(east, north) for north, east, _ in away.tolist()])

    def predicted_region(self, time_s: float) -> PredictedRegion | None:
        """Return where the target can have been then, seen from us; None if it is not known.

        After some seconds unseen it can be on any side of us.
        """
        here, seen_s = self._own.at(time_s), self._moving.time_s
        if here is None or seen_s is None or time_s - seen_s > _FORESEEN_S:
            return None
        return _outlook(self._moving, time_s, here)

    def earlier_predictions(self, time_s: float) -> list[PredictedRegion]:
        """Return the same by what was believed in the last seconds, the latest first."""
        here = self._own.at(time_s)
        if here is None:
            return []
        outlooks = []
        for then in self._moving.earlier():
            seen_s = then.time_s
            there = None if seen_s is None else self._own.at(seen_s)
            if seen_s is not None and there is not None:
                was_m = length(then.at(seen_s)[0] - there)
                outlook = _outlook(then, time_s, here)
                away_m = length(outlook.away_m)
                nearer = max(was_m, _NEAREST_M) / max(away_m, _NEAREST_M)
                outlooks.append(replace(outlook, seen_s=seen_s, nearer=nearer))
        return outlooks

    def _watch(self, estimate: TargetEstimate, vehicle: VehicleState, here: Vector) -> None:
        """Take in where the target was when it was seen last, if that is news."""
        newest_s, seen_s = self._moving.newest_s, estimate.last_seen_s
        there = self._own.at(seen_s)
        if there is None or (newest_s is not None and seen_s <= newest_s):
            return
        above_m = float(here[2] - there[2])
        raw = seen_again(estimate)
        seen, self._by_ground = self._ranged(raw, vehicle, above_m)
        self.hold_size(seen)
        # Nor bounded upwards like what is steered by: it would go on before us at our own speed.
        range_m, direction = self._distance_m(seen, _LOG_THOUSAND), seen.direction
        self._nearer = self._compared(range_m, raw.log_scale) if self._by_ground else 1.0
        level = np.array([*direction[:2], 0.0]) / max(math.hypot(*direction[:2]), 1e-6)
        along = ALONG_GROUND if self._by_ground else ALONG
        noise = place_noise(
            level if self._by_ground else direction, along * range_m, ACROSS * range_m
        )
        slow_m = 0.0 if self._by_ground else self._settings.size_error_share * range_m
        self._moving.observe(there + range_m * direction, noise, seen_s, direction, slow_m)

    def _compared(self, range_m: float, log_scale: float) -> float:
        """Return what share of a range by the ground is safe to count on, by the target's size."""
        self._known.learn(range_m, log_scale)
        return min(_LARGER * self._known.range_m(log_scale) / range_m, 1.0)

    def _ranged(
        self, estimate: TargetEstimate, vehicle: VehicleState, higher_m: float
    ) -> tuple[TargetEstimate, bool]:
        """Put the range by the ground into the place of the one by size, if that is wanted.

        Args:
            estimate: of the target.
            vehicle: with a position, our newest one.
            higher_m: how much higher we were when the estimate holds.
        """
        position, height_m = vehicle.position, vehicle.above_ground_m(estimate.time_s)
        if self._settings.range_from is RangeFrom.SIZE or position is None or height_m is None:
            return estimate, False
        size_m = self._settings.target_size_m or self._settings.distance_m
        self._wanted_log_scale = math.log(size_m / self._settings.distance_m)
        above_m = height_m + higher_m - self._settings.target_middle_m
        ranged = ranged_by_ground(estimate, size_m, above_m, -position.down_m_s)
        if ranged is not estimate:
            return ranged, True
        if self._settings.target_size_m is not None:
            return estimate, False
        # The ground says nothing: the size counts that fitted when it did.
        self._known.assume(self._settings.distance_m, estimate.log_scale)
        log_range = math.log(self._known.range_m(estimate.log_scale))
        return replace(estimate, log_scale=math.log(size_m) - log_range), False

    def errors(
        self, estimate: TargetEstimate, yaw: float, mode: FollowMode, interval_s: float
    ) -> ServoErrors:
        """Return how far the pursuit is from what is wanted, `interval_s` after the last time."""
        range_m = self.range_m(estimate)
        wanted = self._reference.elevation_rad
        wanted = _STRAIGHT_DOWN_RAD if mode is FollowMode.OVERHEAD else wanted
        velocity = complex(0.0)
        if self._velocity_m_s is not None:
            velocity = complex(*self._velocity_m_s[:2].tolist())
            self.target.update(velocity, interval_s)
        return ServoErrors(
            azimuth_rad=wrap_angle(azimuth_of(estimate) - yaw),
            elevation_rad=estimate.height_angle_rad - wanted,
            log_range=math.log(range_m / self._reference.distance_m),
            range_m=range_m,
            target_speed_m_s=_speed_away(velocity, estimate),
            range_deviation_m=self._range_deviation_m(estimate, range_m),
            is_level=self._nearer == 1.0,
        )

    def _range_deviation_m(self, estimate: TargetEstimate, range_m: float) -> float:
        """Return by how much the range is usually wrong.

        The filter takes errors for white, so that it says too little about those of a size.
        """
        own = 0.0 if self._by_ground else SIZE_ERROR * range_m
        too_far = range_m - min(self._nearer * range_m, self._unbounded_m(estimate))
        if self._velocity_m_s is None:
            return own + too_far
        moving = self._moving.deviation_m(estimate.time_s, estimate.direction)
        return math.hypot(own, moving) + too_far

    def range_m(self, estimate: TargetEstimate) -> float:
        """Return the distance to the target, within a factor of ten of the wanted one.

        A distance wanted anew is gone to in steps: both count, the one meanwhile and the last.
        """
        nearest = min(self._meanwhile, 0.0) - _LOG_TEN
        log_range = min(max(self._log_range(estimate), nearest), self._farthest)
        return self._settings.distance_m * math.exp(log_range)

    def _unbounded_m(self, estimate: TargetEstimate) -> float:
        """Return the distance to the target, however near: the keep-out has to know."""
        return self._distance_m(estimate, self._farthest)

    @property
    def _meanwhile(self) -> float:
        """The logarithm of the distance wanted at present over the one to come."""
        return math.log(self._reference.distance_m / self._settings.distance_m)

    @property
    def _farthest(self) -> float:
        return max(self._meanwhile, 0.0) + _LOG_TEN

    def _distance_m(self, estimate: TargetEstimate, most: float) -> float:
        """Return the distance; the logarithm of it over the wanted one is at most so much."""
        return self._settings.distance_m * math.exp(min(self._log_range(estimate), most))

    def _log_range(self, estimate: TargetEstimate) -> float:
        """Return the logarithm of the distance over the wanted one."""
        wanted = estimate.log_scale if self._wanted_log_scale is None else self._wanted_log_scale
        return wanted - estimate.log_scale


def _outlook(moving: TargetWorldFilter, time_s: float, here_m: Vector) -> PredictedRegion:
    likely_m, possible_m = (moving.reach_m(time_s, *one) for one in (_LIKELY, _POSSIBLE))
    away_m = moving.at(time_s)[0] - here_m
    return PredictedRegion(away_m, likely_m, possible_m, from_m=here_m)


def _speed_away(velocity_m_s: complex, estimate: TargetEstimate) -> float:
    """Return what of a velocity leads away from us; from above, that is sinking, which none is."""
    if estimate.frame is BearingFrame.DOWN:
        return 0.0
    return (velocity_m_s * cmath.rect(1.0, -azimuth_of(estimate))).real
