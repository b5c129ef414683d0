"""What a link knows about the vehicle, each part with the time at which it was true."""

import math
from collections import deque
from dataclasses import dataclass
from statistics import median

from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint

ENTRY_S = 2.5
"""How long after our last setpoint the mode that needs them may turn out to have been taken.

PX4 lets a pilot into OFFBOARD for COM_OF_LOSS_T (1 s) after a setpoint, goes into its failsafe
0.25 s after that time without another, and sends its mode unasked once a second.
"""

_EARTH_M = 6_371_000.0
"""Mean radius; over a kilometre the ellipsoid makes less than 4 m of difference."""

_STALE_S = 1.0
_KEPT_SAMPLES = 5
_LEAST_SAMPLES = 3
_OUTLIER_M_S = 2.0
_OUTLIER_RAD_S = 1.0


@dataclass(frozen=True, slots=True)
class Attitude:
    """Orientation of the body (forward, right, down) in the world (north, east, down).

    Attributes:
        roll_rad: right wing down is positive.
        pitch_rad: nose up is positive.
        yaw_rad: from north, clockwise seen from above.
        roll_rate_rad_s: body rate about forward.
        pitch_rate_rad_s: body rate about right.
        yaw_rate_rad_s: body rate about down.
        time_s: when this was true, on the system's clock.
    """

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    roll_rate_rad_s: float
    pitch_rate_rad_s: float
    yaw_rate_rad_s: float
    time_s: float

    @property
    def turn_rate_rad_s(self) -> float:
        """How fast it turns, about whichever axis, rad/s."""
        return math.hypot(self.roll_rate_rad_s, self.pitch_rate_rad_s, self.yaw_rate_rad_s)

    @property
    def numbers(self) -> tuple[float, ...]:
        """The angles, rad, and the body rates, rad/s."""
        return (
            *(self.roll_rad, self.pitch_rad, self.yaw_rad),
            *(self.roll_rate_rad_s, self.pitch_rate_rad_s, self.yaw_rate_rad_s),
        )

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(map(math.isfinite, self.numbers)) and math.isfinite(self.time_s)


@dataclass(frozen=True, slots=True)
class LocalPosition:
    """Position and velocity in a world frame fixed at the autopilot's origin.

    Attributes:
        north_m, east_m, down_m: position.
        north_m_s, east_m_s, down_m_s: velocity.
        time_s: when this was true, on the system's clock.
        home_m: where home is in that frame, NED; None before the autopilot told it: the origin.
    """

    north_m: float
    east_m: float
    down_m: float
    north_m_s: float
    east_m_s: float
    down_m_s: float
    time_s: float
    home_m: tuple[float, float, float] | None = None

    @property
    def numbers(self) -> tuple[float, ...]:
        """The position, metres NED, and the velocity, m/s."""
        return (
            *(self.north_m, self.east_m, self.down_m),
            *(self.north_m_s, self.east_m_s, self.down_m_s),
        )

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(map(math.isfinite, self.numbers)) and math.isfinite(self.time_s)

    @property
    def height_m(self) -> float:
        """Height above home, metres."""
        return (0.0 if self.home_m is None else self.home_m[2]) - self.down_m

    @property
    def from_home_m(self) -> tuple[float, float]:
        """Distance north and east of home, metres."""
        north_m, east_m, _ = self.home_m or (0.0, 0.0, 0.0)
        return self.north_m - north_m, self.east_m - east_m


@dataclass(frozen=True, slots=True)
class RcChannels:
    """What the pilot's transmitter sends, as the autopilot passes it on.

    Attributes:
        pulses_us: each channel's pulse, the first one first; 0 where there is none.
        time_s: when they arrived.
    """

    pulses_us: tuple[int, ...]
    time_s: float

    def pulse_us(self, channel: int) -> int | None:
        """Return a channel's pulse, counted from 1; None if it has none that can be one."""
        pulse = self.pulses_us[channel - 1] if 1 <= channel <= len(self.pulses_us) else 0
        return pulse if 800 <= pulse <= 2200 else None


@dataclass(frozen=True, slots=True)
class GimbalState:
    """How a gimbal holds its camera.

    Attributes:
        attitude: angles and rates of the camera, as if it were a body that looks along its nose.
        is_level: roll and pitch are against the horizon; else against the vehicle's body.
        from_north: yaw is from north; else from the vehicle's nose.
    """

    attitude: Attitude
    is_level: bool = True
    from_north: bool = False

    @property
    def time_s(self) -> float:
        """When this was true."""
        return self.attitude.time_s

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return self.attitude.is_finite


@dataclass(frozen=True, slots=True)
class Clearance:
    """How high the vehicle is above what is below it.

    Attributes:
        height_m: by a rangefinder that looks down, or by a terrain map.
        time_s: when this was true, on the system's clock.
    """

    height_m: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the origin of local positions is.

    Attributes:
        latitude_deg: north is positive.
        longitude_deg: east is positive.
    """

    latitude_deg: float
    longitude_deg: float

    def geolocated(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Return latitude and longitude, degrees, of a local place."""
        across_m = _EARTH_M * math.cos(math.radians(self.latitude_deg))
        latitude_deg = self.latitude_deg + math.degrees(north_m / _EARTH_M)
        longitude_deg = self.longitude_deg + math.degrees(east_m / across_m)
        return latitude_deg, _within_half_turn(longitude_deg)

    def local(self, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
        """Return how far north and east, metres, a place is."""
        across_m = _EARTH_M * math.cos(math.radians(self.latitude_deg))
        north_m = _EARTH_M * math.radians(latitude_deg - self.latitude_deg)
        around_deg = _within_half_turn(longitude_deg - self.longitude_deg)
        return north_m, across_m * math.radians(around_deg)


def _within_half_turn(degrees: float) -> float:
    """Return an angle from -180 to 180; one that is, is left as it is, to the last bit."""
    return degrees if -180 <= degrees <= 180 else (degrees + 180) % 360 - 180


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The newest of everything; a part never received is None.

    Attributes:
        attitude: newest attitude.
        position: newest local position and velocity.
        mode: the autopilot's flight mode by its own name, e.g. "OFFBOARD", "GUIDED", "LOITER".
        obeys_setpoints: that mode is the one in which velocity setpoints are flown.
        armed: motors may turn.
        landed: on the ground, None if the autopilot does not say.
        heartbeat_s: when the last heartbeat arrived, None before the first.
        failsafe: the autopilot says that it is in a failsafe or worse.
        entries: how often it was seen to enter that mode.
        entered_by_itself: it did so out of a failsafe the last time, or was armed and in it when
            it was first received: nobody chose the mode for us.
        rc: the pilot's sticks and switches, None where the autopilot does not show them.
        gimbal: how a gimbal holds its camera, None without one.
        clearance: height above what is below, None where nothing measures it.
        origin: where the origin of local positions is, None before it is received.
        answered_s: when it last answered something that we had asked, so that it receives us; None
            before the first time.
    """

    attitude: Attitude | None = None
    position: LocalPosition | None = None
    mode: str = ""
    obeys_setpoints: bool = False
    armed: bool = False
    landed: bool | None = None
    heartbeat_s: float | None = None
    failsafe: bool = False
    entries: int = 0
    entered_by_itself: bool = False
    rc: RcChannels | None = None
    gimbal: GimbalState | None = None
    clearance: Clearance | None = None
    origin: Origin | None = None
    answered_s: float | None = None

    def attitude_age_s(self, now_s: float) -> float:
        """Age of the attitude, seconds; infinite if there is none."""
        return math.inf if self.attitude is None else now_s - self.attitude.time_s

    def position_age_s(self, now_s: float) -> float:
        """Age of the position, seconds; infinite if there is none."""
        return math.inf if self.position is None else now_s - self.position.time_s

    def fresh_clearance_m(self, now_s: float) -> float | None:
        """Return the height above what is below, unless nothing measured it lately."""
        known = self.clearance
        return None if known is None or now_s - known.time_s > _STALE_S else known.height_m

    def above_ground_m(self, now_s: float) -> float | None:
        """Return the same, or else the height above home; None where neither is known."""
        measured = self.fresh_clearance_m(now_s)
        if measured is not None or self.position is None:
            return measured
        return self.position.height_m

    def heartbeat_age_s(self, now_s: float) -> float:
        """Age of the last heartbeat, seconds; infinite if there was none."""
        return math.inf if self.heartbeat_s is None else now_s - self.heartbeat_s

    def answer_age_s(self, now_s: float) -> float:
        """For how many seconds it has not answered us; 0 for one that never did."""
        return 0.0 if self.answered_s is None else now_s - self.answered_s

    def fresh_rc(self, now_s: float, within_s: float) -> RcChannels | None:
        """Return the pilot's channels unless they are older than that."""
        fresh = self.rc is not None and 0 <= now_s - self.rc.time_s <= within_s
        return self.rc if fresh else None


class PresentMotion:
    """The newest velocity and yaw rate of telemetry, unless they contradict the last few.

    A setpoint stream begins where the vehicle is. A single glitch of its velocity at that time
    would be flown for seconds, for it fades away within acceleration and jerk.
    """

    def __init__(self) -> None:
        self._vehicle = VehicleState()
        self._velocities: deque[tuple[float, float, float]] = deque(maxlen=_KEPT_SAMPLES)
        self._yaw_rates: deque[float] = deque(maxlen=_KEPT_SAMPLES)

    def update(self, vehicle: VehicleState) -> None:
        """Take the newest telemetry, the same again if there is none newer."""
        before, self._vehicle = self._vehicle, vehicle
        position, attitude = vehicle.position, vehicle.attitude
        if position is not None and position is not before.position:
            self._velocities.append((position.north_m_s, position.east_m_s, position.down_m_s))
        if attitude is not None and attitude is not before.attitude:
            self._yaw_rates.append(attitude.yaw_rate_rad_s)

    @property
    def present(self) -> VelocitySetpoint:
        """The motion as a setpoint in the heading's frame; standing still where it is unknown."""
        attitude = self._vehicle.attitude
        if not self._velocities or attitude is None:
            return HOLD
        parts = zip(*self._velocities, strict=True)
        velocity = tuple(_without_outlier(part, _OUTLIER_M_S) for part in parts)
        return _in_heading(
            velocity, attitude.yaw_rad, _without_outlier(tuple(self._yaw_rates), _OUTLIER_RAD_S)
        )


def heading_velocity(vehicle: VehicleState) -> VelocitySetpoint:
    """Return the motion of telemetry as a setpoint; standing still where it is unknown."""
    position, attitude = vehicle.position, vehicle.attitude
    if position is None or attitude is None:
        return HOLD
    velocity = position.north_m_s, position.east_m_s, position.down_m_s
    return _in_heading(velocity, attitude.yaw_rad, attitude.yaw_rate_rad_s)


def _in_heading(
    velocity: tuple[float, ...], yaw_rad: float, yaw_rate_rad_s: float
) -> VelocitySetpoint:
    north, east, down = velocity
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return VelocitySetpoint(c * north + s * east, c * east - s * north, down, yaw_rate_rad_s)


def _without_outlier(values: tuple[float, ...], far: float) -> float:
    """Return the last one, or the middle one if the last is far from that."""
    newest, middle = values[-1], median(values)
    return newest if len(values) < _LEAST_SAMPLES or abs(newest - middle) <= far else middle
