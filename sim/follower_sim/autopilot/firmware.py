"""The numbers in which the two autopilots differ."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from follower_sim.firmware_parameters import ARDUCOPTER_PARAMETERS, PX4_PARAMETERS
from follower_sim.flight_modes import ARDUCOPTER_MODES, PX4_MODES, FlightMode
from follower_sim.response import ARDUCOPTER_RESPONSE, PX4_RESPONSE, VehicleResponse


@dataclass(frozen=True, slots=True)
class Limits:
    """What a set-point is clipped to."""

    horizontal_m_s: float
    up_m_s: float
    down_m_s: float
    yaw_rate_deg_s: float

    @property
    def yaw_rate_rad_s(self) -> float:
        """The yaw rate in rad/s."""
        return math.radians(self.yaw_rate_deg_s)


@dataclass(frozen=True, slots=True)
class Firmware:
    """One autopilot's constants; times in seconds, heights in metres.

    Attributes:
        name: "px4" or "ardupilot".
        mav_autopilot: HEARTBEAT.autopilot.
        version: of the firmware, as AUTOPILOT_VERSION packs it.
        response: how the vehicle moves.
        modes: by name.
        start_mode, hold_mode, setpoint_mode: names.
        limits: on set-points.
        heading_turn_deg_s: how fast it turns to a heading.
        takeoff_speed_m_s, landing_speed_m_s, cruise_m_s: of its own manoeuvres.
        return_height_m: at which it flies home.
        spool_up_s: from arming until it can lift off.
        disarm_landed_s: from touching down until it disarms itself.
        disarm_idle_s: from arming until it gives up waiting for a take-off.
        unfit_text: what it says when it is asked to arm before it is fit to fly.
        parameters: what PARAM_REQUEST_READ finds.
        message_rates_hz: what it sends unasked, by message name.
        home: latitude and longitude in degrees, height above mean sea level.
    """

    name: str
    mav_autopilot: int
    version: tuple[int, int, int]
    response: VehicleResponse
    modes: dict[str, FlightMode]
    start_mode: str
    hold_mode: str
    setpoint_mode: str
    limits: Limits
    heading_turn_deg_s: float
    takeoff_speed_m_s: float
    landing_speed_m_s: float
    cruise_m_s: float
    return_height_m: float
    spool_up_s: float
    disarm_landed_s: float
    disarm_idle_s: float
    unfit_text: str
    parameters: dict[str, float]
    message_rates_hz: dict[str, float]
    home: tuple[float, float, float] = field(default=(47.397742, 8.545594, 488.0))

    def mode_of(self, custom_mode: int) -> FlightMode | None:
        """Return the mode with this number, None if it is not simulated."""
        return next((m for m in self.modes.values() if m.custom_mode == custom_mode), None)


PX4 = Firmware(
    name="px4",
    mav_autopilot=12,
    version=(1, 18, 0),
    response=PX4_RESPONSE,
    modes=PX4_MODES,
    start_mode="LOITER",
    hold_mode="LOITER",
    setpoint_mode="OFFBOARD",
    limits=Limits(12.0, 3.0, 1.5, 200.0),
    heading_turn_deg_s=60.0,
    takeoff_speed_m_s=1.5,
    landing_speed_m_s=0.7,
    cruise_m_s=5.0,
    return_height_m=30.0,
    spool_up_s=1.0,
    disarm_landed_s=2.0,
    disarm_idle_s=10.0,
    unfit_text="Arming denied: Resolve system health failures first",
    parameters=PX4_PARAMETERS,
    message_rates_hz={
        "HEARTBEAT": 1.0,
        "SYS_STATUS": 1.0,
        "ATTITUDE": 100.0,
        "LOCAL_POSITION_NED": 30.0,
        "GLOBAL_POSITION_INT": 10.0,
        "EXTENDED_SYS_STATE": 5.0,
    },
)
"""PX4 1.18 with default parameters."""

ARDUCOPTER = Firmware(
    name="ardupilot",
    mav_autopilot=3,
    version=(4, 6, 3),
    response=ARDUCOPTER_RESPONSE,
    modes=ARDUCOPTER_MODES,
    start_mode="STABILIZE",
    hold_mode="LOITER",
    setpoint_mode="GUIDED",
    limits=Limits(10.0, 10.0, 10.0, 60.0),
    heading_turn_deg_s=60.0,
    takeoff_speed_m_s=2.5,
    landing_speed_m_s=0.5,
    cruise_m_s=10.0,
    return_height_m=15.0,
    spool_up_s=2.0,
    disarm_landed_s=1.0,
    disarm_idle_s=10.0,
    unfit_text="Arm: Need Position Estimate",
    parameters=ARDUCOPTER_PARAMETERS,
    message_rates_hz={
        "HEARTBEAT": 1.0,
        "SYS_STATUS": 1.0,
        "ATTITUDE": 50.0,
        "LOCAL_POSITION_NED": 50.0,
        "GLOBAL_POSITION_INT": 10.0,
        "EXTENDED_SYS_STATE": 5.0,
    },
    home=(-35.363262, 149.165237, 584.0),
)
"""ArduCopter 4.6.3 with default parameters."""
