"""What a link knows about the vehicle, each part with the time at which it was true."""

from __future__ import annotations

import math
from dataclasses import dataclass

ENTRY_S = 2.5
"""How long after our last setpoint the mode that needs them may turn out to have been taken.

PX4 lets a pilot into OFFBOARD for COM_OF_LOSS_T (1 s) after a setpoint, goes into its failsafe
0.25 s after that time without another, and tells its mode by itself once a second.
"""


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
        """How fast it turns, about whichever axis."""
        return math.hypot(self.roll_rate_rad_s, self.pitch_rate_rad_s, self.yaw_rate_rad_s)

    @property
    def numbers(self) -> tuple[float, ...]:
        """The angles and the rates."""
        return (
            self.roll_rad,
            self.pitch_rad,
            self.yaw_rad,
            self.roll_rate_rad_s,
            self.pitch_rate_rad_s,
            self.yaw_rate_rad_s,
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
    """

    north_m: float
    east_m: float
    down_m: float
    north_m_s: float
    east_m_s: float
    down_m_s: float
    time_s: float

    @property
    def numbers(self) -> tuple[float, ...]:
        """The position and the velocity."""
        return (
            self.north_m,
            self.east_m,
            self.down_m,
            self.north_m_s,
            self.east_m_s,
            self.down_m_s,
        )

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(map(math.isfinite, self.numbers)) and math.isfinite(self.time_s)

    @property
    def height_m(self) -> float:
        """Height above the origin, metres."""
        return -self.down_m


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


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The newest of everything; a part never heard of is None.

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
            it was first heard: nobody chose the mode for us.
        rc: the pilot's sticks and switches, None where the autopilot does not show them.
        gimbal: how a gimbal holds its camera, None without one.
        clearance: height above what is below, None where nothing measures it.
        origin: where the origin of local positions is, None before it is told.
        answered_s: when it last answered something that we had asked, so that it hears us; None
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
        """Age of the attitude; infinite if there is none."""
        return math.inf if self.attitude is None else now_s - self.attitude.time_s

    def position_age_s(self, now_s: float) -> float:
        """Age of the position; infinite if there is none."""
        return math.inf if self.position is None else now_s - self.position.time_s

    def heartbeat_age_s(self, now_s: float) -> float:
        """Age of the last heartbeat; infinite if there was none."""
        return math.inf if self.heartbeat_s is None else now_s - self.heartbeat_s

    def answer_age_s(self, now_s: float) -> float:
        """How long it has not answered us; 0 for one that never did."""
        return 0.0 if self.answered_s is None else now_s - self.answered_s

    def fresh_rc(self, now_s: float, within_s: float) -> RcChannels | None:
        """Return the pilot's channels unless they are older than that."""
        fresh = self.rc is not None and 0 <= now_s - self.rc.time_s <= within_s
        return self.rc if fresh else None
