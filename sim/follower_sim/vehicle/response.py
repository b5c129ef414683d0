"""How a multirotor under its autopilot answers a velocity demand: parameters with names."""

import math
from dataclasses import dataclass

from follower_control.common.strict_config import check_ranges
from follower_sim.kinematics import Triple


@dataclass(frozen=True, slots=True)
class Shaping:
    """Acceleration and jerk limits that turn a step into an S-curve before the loop sees it.

    The acceleration asked for is (jerk / acceleration) times the velocity error, as ArduPilot's
    `shape_vel_accel` does it: the curve ends in an exponential with that rate.
    """

    acceleration_m_s2: float
    jerk_m_s3: float

    @property
    def rate_per_s(self) -> float:
        """Acceleration per velocity error, m/s² per m/s."""
        return self.jerk_m_s3 / self.acceleration_m_s2


@dataclass(frozen=True, slots=True)
class VelocityLoop:
    """A PID loop from velocity error to acceleration.

    Attributes:
        p_per_s: acceleration per velocity error.
        i_per_s2: growth of the acceleration per velocity error.
        d: share of the acceleration error that is fed back.
        position_per_s: velocity per distance to where the shaped velocity would have led; 0 for a
            loop that knows no position.
        shaping: limits on the demand; None hands steps straight to the loop.
    """

    p_per_s: float
    i_per_s2: float
    d: float = 0.0
    position_per_s: float = 0.0
    shaping: Shaping | None = None


@dataclass(frozen=True, slots=True)
class TiltResponse:
    """Roll and pitch: a second-order lag behind the tilt that the acceleration needs."""

    natural_frequency_rad_s: float
    damping: float
    max_tilt_deg: float

    @property
    def max_acceleration_m_s2(self) -> float:
        """Horizontal acceleration, m/s², at the largest tilt while height is held."""
        return 9.80665 * math.tan(math.radians(self.max_tilt_deg))


@dataclass(frozen=True, slots=True)
class YawResponse:
    """A rate loop (PI, behind a lag of the motors), with or without a heading to keep.

    Attributes:
        p_per_s: yaw acceleration per rate error.
        i_per_s2: growth of the yaw acceleration per rate error.
        lag_s: time constant of the yaw torque.
        drag_per_s: yaw acceleration lost per rate.
        max_acceleration_deg_s2: the most torque there is.
        dead_time_s: from the arrival of a demand until the loop sees it.
        heading_per_s: rate per error to the heading that the demand would have led to; 0 keeps
            no heading.
        turn_per_s: rate per angle that keeps the heading while the tilt changes; 0 lets it turn.
    """

    p_per_s: float
    i_per_s2: float
    lag_s: float
    drag_per_s: float
    max_acceleration_deg_s2: float
    dead_time_s: float
    heading_per_s: float = 0.0
    turn_per_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Drag:
    """Deceleration through the air: linear and quadratic in the airspeed."""

    linear_per_s: float
    quadratic_per_m: float
    vertical_per_s: float

    def __post_init__(self) -> None:
        # More stops it within a step of the simulation.
        check_ranges(self, linear_per_s=(0, 10), quadratic_per_m=(0, 1), vertical_per_s=(0, 10))


@dataclass(frozen=True, slots=True)
class VehicleResponse:
    """All that shapes the way from a velocity demand to motion.

    Attributes:
        dead_time_s: from the arrival of a velocity until its loops see it.
        horizontal, vertical: the velocity loops.
        tilt: roll and pitch.
        thrust_lag_s: time constant of the vertical acceleration.
        max_climb_acceleration_m_s2: what thrust is left above hovering.
        yaw: the yaw loop.
        drag: the air.
        climb_share, descent_share: the vertical velocity aimed at over the one demanded.
        max_vertical_bias_m_s: the most by which they differ.
    """

    dead_time_s: float
    horizontal: VelocityLoop
    vertical: VelocityLoop
    tilt: TiltResponse
    thrust_lag_s: float
    max_climb_acceleration_m_s2: float
    yaw: YawResponse
    drag: Drag
    climb_share: float = 1.0
    descent_share: float = 1.0
    max_vertical_bias_m_s: float = 0.0

    def biased(self, down_m_s: float) -> float:
        """Return the vertical velocity, m/s down, that is aimed at when this one is demanded."""
        share = self.climb_share if down_m_s < 0 else self.descent_share
        most = self.max_vertical_bias_m_s
        return down_m_s + max(-most, min(most, (share - 1.0) * down_m_s))


ARDUCOPTER_RESPONSE = VehicleResponse(
    dead_time_s=0.04,
    horizontal=VelocityLoop(2.2, 2.2, 0.6, 1.6, Shaping(2.5, 5.0)),
    vertical=VelocityLoop(1.4, 1.2, 0.0, 0.8, Shaping(1.0, 5.0)),
    tilt=TiltResponse(14.0, 1.0, 30.0),
    thrust_lag_s=0.11,
    max_climb_acceleration_m_s2=8.0,
    yaw=YawResponse(6.4, 0.0, 0.197, 0.0, 240.0, 0.08, 0.11),
    drag=Drag(0.243, 0.031, 0.05),
)
"""ArduCopter 4.6 with default parameters: its limits are the parameters' (WPNAV_ACCEL, PSC_JERK_XY,
ANGLE_MAX); gains, lags and drag are fitted to the recordings."""

PX4_RESPONSE = VehicleResponse(
    dead_time_s=0.06,
    horizontal=VelocityLoop(1.8, 0.45, 0.2),
    vertical=VelocityLoop(4.3, 1.6),
    tilt=TiltResponse(7.0, 0.8, 45.0),
    thrust_lag_s=0.065,
    max_climb_acceleration_m_s2=8.0,
    yaw=YawResponse(3.8, 2.1, 0.15, 1.0, 250.0, 0.08, turn_per_s=1.12),
    drag=Drag(1.0, 0.0, 0.88),
    climb_share=1.15,
    descent_share=0.89,
    max_vertical_bias_m_s=0.15,
)
"""PX4 1.18 with default parameters: the horizontal loop is its own (MPC_XY_VEL_P_ACC, I, D) against
the drag of its SIH quadrotor, which explains the slow tail, and its heading is kept while it tilts
by MC_YAW_P times the yaw weight; the rest is fitted to recorded steps, px_calm1 and half of
px_wind3."""


@dataclass(frozen=True, slots=True)
class Demand:
    """A velocity in the world and a yaw rate.

    Attributes:
        velocity_m_s: (north, east, down).
        yaw_rate_rad_s: positive is clockwise seen from above.
    """

    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    yaw_rate_rad_s: float = 0.0


STAND_STILL = Demand()
