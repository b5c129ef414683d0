"""The envelope's limits."""

from dataclasses import dataclass, field, fields

from follower_control.common.strict_config import check_positive, check_ranges
from follower_control.envelope.fence import Fence, check_corners
from follower_control.target.settings import TrustSettings

_RANGES = {
    **dict.fromkeys(("max_speed_m_s", "max_climb_m_s", "max_descent_m_s"), (0.01, 100)),
    **dict.fromkeys(("max_acceleration_m_s2", "braking_m_s2"), (0.01, 100)),
    "max_jerk_m_s3": (0.01, 10_000),
    "max_yaw_rate_deg_s": (0.1, 1000),
    "max_yaw_acceleration_deg_s2": (0.1, 100_000),
    "max_yaw_jerk_deg_s3": (0.1, 10_000_000),
    "reaction_s": (1e-3, 10),
    "max_interval_s": (1e-3, 1),
}
"""What no vehicle exceeds, and with what the numbers that are sent can be computed."""


@dataclass(frozen=True, slots=True)
class EnvelopeSettings:
    """The limits. None switches off one that needs telemetry or a target.

    Attributes:
        max_speed_m_s: horizontally, in any direction.
        max_climb_m_s: upwards.
        max_descent_m_s: downwards.
        max_acceleration_m_s2: horizontally, and vertically, each by itself.
        max_jerk_m_s3: likewise.
        max_yaw_rate_deg_s: either way. ArduCopter flies no more than 60 (ATC_SLEW_YAW), PX4 200
            (MC_YAWRATE_MAX).
        max_yaw_acceleration_deg_s2: either way; ArduCopter's own limit (ATC_ACCEL_Y_MAX).
        max_yaw_jerk_deg_s3: either way. The default reaches that acceleration within 0.2 s, the
            time constant of ArduCopter's yaw torque; the vehicle cannot follow faster. None is
            unlimited.
        min_height_m: above home; no descent below it.
        ceiling_m: above home; no climb above it.
        min_clearance_m: above what is below, where a rangefinder or a terrain map gives it.
        fence_radius_m: around home; no motion away from home beyond it.
        fence_m: corners (north, east) in metres from home of a polygon that is not left; outside
            of it, there is only motion back.
        fence_deg: the same by corners (latitude, longitude), in degrees.
        fence_margin_m: how far inside the circle and the polygon's sides the vehicle stops.
        min_distance_m: to the target; no motion towards a standing target within that. A target
            that moves away is taken to brake like us (Gipps, 1981), so that it can be followed.
        braking_m_s2: with what deceleration speeds are reduced ahead of these; vertically at most
            1 m/s2, ArduCopter's own.
        trust: how the largest speed falls with the quality of the estimate.
        reaction_s: how long the vehicle takes to answer, counted before it brakes.
        max_interval_s: longer pauses between two calls count as this long.
    """

    max_speed_m_s: float = 10.0
    max_climb_m_s: float = 2.0
    max_descent_m_s: float = 1.5
    max_acceleration_m_s2: float = 3.0
    max_jerk_m_s3: float = 10.0
    max_yaw_rate_deg_s: float = 60.0
    max_yaw_acceleration_deg_s2: float = 270.0
    max_yaw_jerk_deg_s3: float | None = 1350.0
    min_height_m: float | None = 3.0
    ceiling_m: float | None = 50.0
    min_clearance_m: float | None = 2.0
    fence_radius_m: float | None = 200.0
    fence_m: tuple[tuple[float, float], ...] | None = None
    fence_deg: tuple[tuple[float, float], ...] | None = None
    fence_margin_m: float = 3.0
    min_distance_m: float | None = 4.0
    braking_m_s2: float = 2.0
    reaction_s: float = 1.0
    trust: TrustSettings = field(default_factory=TrustSettings)
    max_interval_s: float = 0.1

    def __post_init__(self) -> None:
        others = {"fence_m", "fence_deg", "trust"}
        check_positive(self, *(one.name for one in fields(self) if one.name not in others))
        check_ranges(self, **_RANGES)
        if self.braking_m_s2 > self.max_acceleration_m_s2:
            raise ValueError("braking_m_s2 is at most max_acceleration_m_s2")
        low, high = self.min_height_m, self.ceiling_m
        if low is not None and high is not None and low >= high:
            raise ValueError(f"min_height_m lies below ceiling_m, not {low} and {high}")
        if self.fence_m is not None and self.fence_deg is not None:
            raise ValueError("a polygon is given by fence_m or by fence_deg, not by both")
        if self.fence_m is not None:
            check_corners(self.fence_m)
        if self.fence_deg is not None:
            for latitude_deg, longitude_deg in self.fence_deg:
                if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
                    raise ValueError(
                        "fence_deg has corners (latitude, longitude) of at most 90 and 180 deg, "
                        f"not ({latitude_deg:g}, {longitude_deg:g})"
                    )
            Fence.around(next(iter(self.fence_deg), (0.0, 0.0)), self.fence_deg)
