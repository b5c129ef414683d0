"""The last thing before the link: whatever is asked, what leaves here is within limits.

The order is: refuse what is not finite, cut to the bounds, then follow with limited acceleration
and jerk. All limits are in the heading frame in which setpoints are flown; the acceleration of a
turning heading is not counted.
"""

import cmath
import math
from dataclasses import dataclass

from follower_control.common.small_matrix import clip
from follower_control.envelope.fence import Fence, circle_bounds
from follower_control.envelope.flight_context import FlightContext, moves_on_m, too_near_m
from follower_control.envelope.jerk_limiter import JerkLimit, Limit, VelocityBound
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint

SLACK = 1e-9
"""What rounding may add to a speed limit, m/s, and to that of the yaw rate, rad/s."""

SHORTEST_S = 1e-6
"""Less time than this is left to add up: rounding would be large against what may change in it."""

HUGE = 1e6
"""Larger components are cut to this before arithmetic that could overflow, m/s."""

TURN_AHEAD_S = 1.0
"""So far ahead the velocity is predicted while the nose turns."""

NOTICEABLE, _NOTICEABLE_RAD_S = 0.05, math.radians(1.0)
"""A smaller difference between asked and allowed velocity is not reported, m/s and rad/s."""

_FIXED = (
    *("max_acceleration_m_s2", "max_jerk_m_s3", "fence_m", "fence_deg"),
    *("max_yaw_acceleration_deg_s2", "max_yaw_jerk_deg_s3"),
)
"""Settings that stay as they were when the flight began."""

_RISE_PER_S = 3.0
"""How much less is sunk, or more climbed, over a target for each metre that it comes too near."""

VERTICAL_BRAKING_M_S2 = 1.0
"""So hard at most a climb or a descent is braked: by default ArduCopter can do no more in GUIDED
(WPNAV_ACCEL_Z)."""

_LEVEL = math.cos(math.radians(45))
_AGAINST, _FASTEST_BACK_M_S = 2.5, 3.0
"""How much is asked for against a velocity that is too fast, per velocity, and at most."""
_LONGEST_AGAINST_S, _SLOWER_M_S = 3.0, 0.1
"""What is not slower by then goes the wrong way, as by a heading that is not true."""

_NO_WAY = tuple(VelocityBound(way, 0.0, Limit.POSITION_UNKNOWN) for way in (1, -1, 1j, -1j))


@dataclass(frozen=True, slots=True)
class LimitedSetpoint:
    """A setpoint with what became of it.

    Attributes:
        asked: what the servo wanted; may be anything.
        allowed: what may be sent.
        limits: what made the difference, nothing if there is none worth the name.
    """

    asked: VelocitySetpoint
    allowed: VelocitySetpoint
    limits: tuple[Limit, ...]


class Envelope:
    """Limits setpoints; keeps the last one allowed, and when.

    Between two calls, the velocity changes by no more than `max_acceleration_m_s2` times the
    interval, and that change's rate by no more than the jerk; likewise the yaw rate, by its own
    acceleration and jerk. The interval is what `now_s` says,
    at most `max_interval_s`, and nothing changes if the time stands still, runs backwards or is
    not finite. The limits on height, fence and distance bound what is steered towards: the
    velocity gets there within acceleration and jerk, ahead of time by `braking_m_s2`, vertically by
    1 m/s2 if that is less, and by `reaction_s`.

    A fence is kept also while the nose turns, for the velocity turns with it: what would lead out
    after `TURN_AHEAD_S` of turning counts already now, and the nose turns slowly meanwhile.

    What is not known is taken for the worst: with a height limit set but no height, neither climb
    nor descent; with a fence but no position or heading, no horizontal motion; with a minimum
    distance but no range to the target, no motion forward. Only a clearance that nobody measures
    limits nothing.
    """

    def __init__(self, settings: EnvelopeSettings | None = None) -> None:
        self._settings = s = settings or EnvelopeSettings()
        self._too_fast_m_s = self._too_steep_m_s = self._too_quick_rad_s = 0.0
        self._max_yaw_rate = math.radians(s.max_yaw_rate_deg_s)
        acceleration, jerk = s.max_acceleration_m_s2, s.max_jerk_m_s3
        self._horizontal = JerkLimit(acceleration, jerk, self._is_flyable)
        self._vertical = JerkLimit(acceleration, jerk, self._is_climbable)
        self._max_yaw_acceleration = math.radians(s.max_yaw_acceleration_deg_s2)
        self._turning: JerkLimit | None = None
        if s.max_yaw_jerk_deg_s3 is not None:
            yaw_jerk = math.radians(s.max_yaw_jerk_deg_s3)
            self._turning = JerkLimit(self._max_yaw_acceleration, yaw_jerk, self._is_turnable)
        self._polygon = None if s.fence_m is None else Fence(s.fence_m)
        self._home_deg: tuple[float, float] | None = None
        self._yaw_rate = 0.0
        self._last_s: float | None = None
        self._limits: list[Limit] = []
        self._turns_out = False
        self._slower_s: float | None = None
        self._slowest_m_s = math.inf

    def change(self, settings: EnvelopeSettings) -> None:
        """Keep other limits from now on; what is beyond them now is brought back within them.

        A velocity above a lower limit is brought down with limited acceleration and jerk.

        Raises:
            ValueError: an acceleration, a jerk or the polygon is another: these stay as they were.
        """
        if any(getattr(settings, name) != getattr(self._settings, name) for name in _FIXED):
            raise ValueError(f"{', '.join(_FIXED)} cannot be changed while flying")
        self._settings = settings
        self._max_yaw_rate = math.radians(settings.max_yaw_rate_deg_s)
        self._too_fast_m_s = self._horizontal.reach
        self._too_steep_m_s = self._vertical.reach
        self._too_quick_rad_s = 0.0 if self._turning is None else self._turning.reach

    def start(self, velocity: VelocitySetpoint = HOLD, now_s: float | None = None) -> None:
        """Begin at the vehicle's present velocity, so that the first setpoint is no step.

        What exceeds the bounds is cut to them; a velocity that is not finite counts as standing.
        """
        known = velocity if velocity.is_finite else HOLD
        self._too_fast_m_s = self._too_steep_m_s = self._too_quick_rad_s = 0.0
        self._horizontal.start(_horizontal(known))
        self._vertical.start(clip(known.down_m_s, HUGE))
        self._yaw_rate = clip(known.yaw_rate_rad_s, self._max_yaw_rate)
        if self._turning is not None:
            self._turning.start(self._yaw_rate)
        self._last_s = now_s if now_s is not None and math.isfinite(now_s) else None
        self._turns_out = False
        self._slower_s, self._slowest_m_s = None, math.inf

    def within_limits(self, velocity: VelocitySetpoint) -> VelocitySetpoint:
        """Return a velocity cut to the largest ones, whatever else is known of the flight."""
        s = self._settings
        speed = math.hypot(velocity.forward_m_s, velocity.right_m_s)
        share = min(1.0, s.max_speed_m_s / speed) if speed > 0 else 1.0
        return VelocitySetpoint(
            share * velocity.forward_m_s,
            share * velocity.right_m_s,
            min(max(velocity.down_m_s, -s.max_climb_m_s), s.max_descent_m_s),
            clip(velocity.yaw_rate_rad_s, self._max_yaw_rate),
        )

    def limit(
        self, asked: VelocitySetpoint, now_s: float, context: FlightContext
    ) -> LimitedSetpoint:
        """Return what is allowed of `asked` at `now_s` (seconds).

        Any numbers whatever are taken.
        """
        self._limits = []
        wanted = asked if asked.is_finite else self._refused()
        interval_s = self._interval(now_s)
        closing_m = self._closing_room(context)
        horizontal = self._wanted_horizontal(wanted, context, closing_m)
        down = self._wanted_down(wanted.down_m_s, context, closing_m)
        yaw_rate = self._cut(wanted.yaw_rate_rad_s, self._max_yaw_rate, Limit.YAW_RATE)
        yaw_rate = self._turned_slowly(yaw_rate)
        velocity = self._horizontal.step(horizontal, interval_s)
        sink = self._vertical.step(down, interval_s).real
        self._too_fast_m_s = min(self._too_fast_m_s, self._horizontal.reach)
        self._too_steep_m_s = min(self._too_steep_m_s, self._vertical.reach)
        self._turn_towards(yaw_rate, interval_s)
        if abs(velocity - horizontal) > NOTICEABLE or abs(sink - down) > NOTICEABLE:
            self._limits.append(Limit.ACCELERATION)
        allowed = VelocitySetpoint(velocity.real, velocity.imag, sink, self._yaw_rate)
        return LimitedSetpoint(asked, allowed, tuple(dict.fromkeys(self._limits)))

    def _refused(self) -> VelocitySetpoint:
        self._limits.append(Limit.NOT_FINITE)
        return HOLD

    def _interval(self, now_s: float) -> float:
        if not math.isfinite(now_s):
            return 0.0
        interval_s = 0.0 if self._last_s is None else now_s - self._last_s
        if 0 < interval_s < SHORTEST_S:
            return 0.0
        self._last_s = now_s
        return min(max(interval_s, 0.0), self._settings.max_interval_s)

    def _wanted_horizontal(
        self, wanted: VelocitySetpoint, context: FlightContext, closing_m: float | None
    ) -> complex:
        velocity, top = _horizontal(wanted), self._settings.max_speed_m_s
        if abs(velocity) > top:
            self._limits.append(Limit.SPEED)
            velocity *= top / abs(velocity)
        (trust,) = context.known("trust") or (1.0,)
        if abs(velocity) > (trusted := top * min(max(trust, 0.0), 1.0)):
            self._limits.append(Limit.DOUBT)
            velocity *= trusted / abs(velocity)
        turn = self._turn_ahead(wanted.yaw_rate_rad_s)
        fences = self._fences(context, turn)
        present = self._horizontal.velocity
        self._turns_out = any(bound.excess(present) > NOTICEABLE for bound in fences)
        if self._turns_out:
            # All of the acceleration goes into braking: what else is wanted has to wait.
            velocity = present
        closing = None if closing_m is None else self._braking_speed(closing_m)
        bounds = (*fences, *_nearness(context, closing))
        velocity = self._braked(velocity, context, bounds)
        for bound in bounds:
            if bound.excess(velocity) > 0:
                self._limits.append(bound.limit)
            velocity = bound.kept(velocity)
        return velocity * min((bound.share(velocity) for bound in bounds), default=1.0)

    def _turn_ahead(self, wanted_rad_s: float) -> float:
        """Return by how much the nose will have turned soon."""
        wanted = clip(wanted_rad_s, self._max_yaw_rate)
        swung = 0.0 if self._turning is None else self._turning.at_rest.real
        return max(wanted, self._yaw_rate, swung, key=abs) * TURN_AHEAD_S

    def _braked(
        self, velocity: complex, context: FlightContext, bounds: tuple[VelocityBound, ...]
    ) -> complex:
        """Ask for less than a bound allows, or for back, while the vehicle itself is too fast.

        PX4 loses the last quarter of its velocity only slowly.
        """
        known = context.known("yaw_rad", "north_m_s", "east_m_s")
        own = 0j if known is None else complex(*known[1:]) * cmath.rect(1.0, -known[0])
        broken = [(bound, excess) for bound in bounds if (excess := bound.excess(own)) > NOTICEABLE]
        if not self._helps_against(abs(own) if broken else None):
            return velocity
        for bound, too_fast in broken:
            least = bound.max_speed_m_s - min(_AGAINST * too_fast, _FASTEST_BACK_M_S)
            velocity -= max(bound.speed(velocity) - least, 0.0) * bound.direction
        return velocity

    def _helps_against(self, too_fast_m_s: float | None) -> bool:
        """Whether braking harder than by asking for less has made it slower, or still may."""
        if too_fast_m_s is None:
            self._slower_s, self._slowest_m_s = None, math.inf
            return True
        if self._slower_s is None or too_fast_m_s < self._slowest_m_s - _SLOWER_M_S:
            self._slower_s, self._slowest_m_s = self._last_s, too_fast_m_s
        if self._slower_s is None or self._last_s is None:
            return True
        return self._last_s - self._slower_s < _LONGEST_AGAINST_S

    def _turned_slowly(self, yaw_rate: float) -> float:
        """Turn no faster than the vehicle can brake, where the velocity would be turned out."""
        speed = abs(self._horizontal.velocity)
        if not self._turns_out or speed * abs(yaw_rate) <= self._settings.braking_m_s2:
            return yaw_rate
        return self._cut(yaw_rate, self._settings.braking_m_s2 / speed, Limit.FENCE)

    def _fences(self, context: FlightContext, turn: float) -> tuple[VelocityBound, ...]:
        s = self._settings
        radius, has_polygon = s.fence_radius_m, s.fence_m is not None or s.fence_deg is not None
        if radius is None and not has_polygon:
            return ()
        known, polygon = context.known("yaw_rad", "north_m", "east_m"), self._fence_at(context)
        if known is None or (has_polygon and polygon is None):
            return _NO_WAY
        yaw, north, east = known
        place, bounds = complex(north, east), []
        if radius is not None:
            bounds += circle_bounds(place, radius - s.fence_margin_m, self._braking_speed)
        if polygon is not None:
            bounds += polygon.bounds(place, s.fence_margin_m, self._braking_speed)
        near = [bound.turned(-yaw) for bound in bounds if bound.max_speed_m_s < s.max_speed_m_s]
        return tuple(turned for bound in near for turned in bound.while_turning(turn))

    def is_outside(self, context: FlightContext) -> bool:
        """Whether the vehicle is known to be where a fence allows motion back alone."""
        place, polygon = context.known("north_m", "east_m"), self._fence_at(context)
        if place is None:
            return False
        radius_m = self._settings.fence_radius_m
        beyond = radius_m is not None and math.hypot(*place) > radius_m
        return beyond or (polygon is not None and not polygon.contains(complex(*place)))

    def _fence_at(self, context: FlightContext) -> Fence | None:
        """Return the polygon in metres; one in degrees needs to know where home is."""
        corners, home = self._settings.fence_deg, context.home_deg
        if corners is not None and home is not None and home != self._home_deg:
            self._polygon, self._home_deg = Fence.around(home, corners), home
        return self._polygon

    def _closing_room(self, context: FlightContext) -> float | None:
        """Return how many metres nearer to the target is near enough; None if no limit is set."""
        nearest = self._settings.min_distance_m
        if nearest is None:
            return None
        known = context.known("target_range_m")
        if known is None:
            return 0.0
        return known[0] + moves_on_m(context, self._settings) - nearest

    def _wanted_down(self, wanted: float, context: FlightContext, closing_m: float | None) -> float:
        s = self._settings
        down = self._over_the_target(wanted, context)
        if down > s.max_descent_m_s:
            down = s.max_descent_m_s
            self._limits.append(Limit.DESCENT)
        if down < -s.max_climb_m_s:
            down = -s.max_climb_m_s
            self._limits.append(Limit.CLIMB)
        down = self._between_heights(down, context)
        return self._off_the_target(self._off_the_ground(down, context), context, closing_m)

    def _off_the_ground(self, down: float, context: FlightContext) -> float:
        lowest, known = self._settings.min_clearance_m, context.known("clearance_m")
        if (
            lowest is None
            or known is None
            or down <= (most := self._vertical_braking_speed(known[0] - lowest))
        ):
            return down
        self._limits.append(Limit.MIN_CLEARANCE)
        return most

    def _over_the_target(self, down: float, context: FlightContext) -> float:
        """Rise over a target below that the vehicle would else come too near to, braking hard.

        A distance by size errs for seconds. What shows that too late to stop in front of a target
        is still in time to stop above it.
        """
        s = self._settings
        missing_m = too_near_m(context, self._horizontal.velocity, s)
        most = max(s.max_descent_m_s - _RISE_PER_S * missing_m, -s.max_climb_m_s)
        if missing_m <= 0 or down <= most:
            return down
        self._limits.append(Limit.TARGET_NEAR)
        return most

    def _off_the_target(self, down: float, context: FlightContext, room_m: float | None) -> float:
        """Neither sink onto a target nor climb into it."""
        known = context.known("target_elevation_rad", "target_range_m")
        if known is None or room_m is None:
            return down
        closing, speed = -math.sin(known[0]) * down, self._vertical_braking_speed(room_m)
        if closing <= speed:
            return down
        self._limits.append(Limit.TARGET_NEAR)
        return down * speed / closing

    def _between_heights(self, down: float, context: FlightContext) -> float:
        low, high = self._settings.min_height_m, self._settings.ceiling_m
        if (low is None and high is None) or down == 0:
            return down
        known = context.known("height_m")
        if known is None:
            self._limits.append(Limit.HEIGHT_UNKNOWN)
            return 0.0
        height = known[0]
        if low is not None and down > (slowest := self._vertical_braking_speed(height - low)):
            self._limits.append(Limit.MIN_HEIGHT)
            return slowest
        if high is not None and -down > (slowest := self._vertical_braking_speed(high - height)):
            self._limits.append(Limit.CEILING)
            return -slowest
        return down

    def _vertical_braking_speed(self, room_m: float) -> float:
        """Return the speed up or down from which the vehicle stops within `room_m`."""
        return self._braking_speed(room_m, VERTICAL_BRAKING_M_S2)

    def _braking_speed(self, room_m: float, hardest_m_s2: float = math.inf) -> float:
        """Return the speed from which the vehicle stops within `room_m`, having reacted."""
        if room_m <= 0:
            return 0.0
        braking = min(self._settings.braking_m_s2, hardest_m_s2)
        delay = self._settings.reaction_s + braking / self._settings.max_jerk_m_s3
        return braking * (math.sqrt(delay**2 + 2 * room_m / braking) - delay)

    def _turn_towards(self, yaw_rate: float, interval_s: float) -> None:
        change = yaw_rate - self._yaw_rate
        if self._turning is None:
            reach = self._max_yaw_acceleration * interval_s
            self._yaw_rate += clip(change, reach)
            limited = abs(change) > reach
        else:
            if interval_s > 0:
                self._yaw_rate = self._turning.step(yaw_rate, interval_s).real
            self._too_quick_rad_s = min(self._too_quick_rad_s, self._turning.reach)
            limited = abs(yaw_rate - self._yaw_rate) > _NOTICEABLE_RAD_S
        if limited:
            self._limits.append(Limit.YAW_ACCELERATION)

    def _cut(self, value: float, largest: float, limit: Limit) -> float:
        if abs(value) > largest:
            self._limits.append(limit)
        return clip(value, largest)

    def _is_flyable(self, velocity: complex) -> bool:
        return abs(velocity) <= max(self._settings.max_speed_m_s, self._too_fast_m_s) + SLACK

    def _is_turnable(self, yaw_rate: complex) -> bool:
        return abs(yaw_rate) <= max(self._max_yaw_rate, self._too_quick_rad_s) + SLACK

    def _is_climbable(self, velocity: complex) -> bool:
        low = max(self._settings.max_climb_m_s, self._too_steep_m_s)
        high = max(self._settings.max_descent_m_s, self._too_steep_m_s)
        return -low - SLACK <= velocity.real <= high + SLACK


def _nearness(context: FlightContext, closing: float | None) -> tuple[VelocityBound, ...]:
    """Return how fast a target may be come nearer to, at most `closing`; None is no limit."""
    if closing is None:
        return ()
    known = context.known("target_range_m", "target_bearing_rad")
    if known is None:
        return (VelocityBound(1, 0.0, Limit.RANGE_UNKNOWN),)
    (elevation,) = context.known("target_elevation_rad") or (0.0,)
    # What goes past above a target comes no nearer to it.
    level = min(math.cos(elevation) / _LEVEL, 1.0)
    return (VelocityBound.towards(known[1], closing / max(level, 1e-3), Limit.TARGET_NEAR),)


def _horizontal(setpoint: VelocitySetpoint) -> complex:
    return complex(clip(setpoint.forward_m_s, HUGE), clip(setpoint.right_m_s, HUGE))
