"""The numbers in which the two autopilots differ."""

from dataclasses import dataclass
from enum import Enum, auto

from follower_sim.autopilot.parameters import ARDUCOPTER_PARAMETERS, PX4_PARAMETERS
from follower_sim.vehicle.response import ARDUCOPTER_RESPONSE, PX4_RESPONSE, VehicleResponse


class Behaviour(Enum):
    """What the simulated autopilot does in a mode; sticks are taken to be centred."""

    HOLD = auto()
    SETPOINTS = auto()
    TAKE_OFF = auto()
    RETURN = auto()
    LAND = auto()


@dataclass(frozen=True, slots=True)
class FlightMode:
    """One flight mode.

    Attributes:
        name: the autopilot's own name, as ground stations show it.
        custom_mode: what HEARTBEAT carries; PX4: main << 16 | sub << 24, ArduCopter: a number.
        behaviour: what it does here.
        can_arm: motors may be armed in it.
    """

    name: str
    custom_mode: int
    behaviour: Behaviour
    can_arm: bool = True


def _px4(name: str, main: int, sub: int, behaviour: Behaviour, can_arm: bool = True) -> FlightMode:
    return FlightMode(name, main << 16 | sub << 24, behaviour, can_arm)


PX4_MODES = {
    mode.name: mode
    for mode in (
        _px4("MANUAL", 1, 0, Behaviour.HOLD),
        _px4("ALTCTL", 2, 0, Behaviour.HOLD),
        _px4("POSCTL", 3, 0, Behaviour.HOLD),
        _px4("TAKEOFF", 4, 2, Behaviour.TAKE_OFF),
        _px4("LOITER", 4, 3, Behaviour.HOLD),
        _px4("RTL", 4, 5, Behaviour.RETURN, can_arm=False),
        _px4("LAND", 4, 6, Behaviour.LAND, can_arm=False),
        _px4("OFFBOARD", 6, 0, Behaviour.SETPOINTS),
        _px4("STABILIZED", 7, 0, Behaviour.HOLD),
    )
}
"""px4_custom_mode.h; LOITER is what PX4's own documents call Hold."""

ARDUCOPTER_MODES = {
    mode.name: mode
    for mode in (
        FlightMode("STABILIZE", 0, Behaviour.HOLD),
        FlightMode("ALT_HOLD", 2, Behaviour.HOLD),
        FlightMode("GUIDED", 4, Behaviour.SETPOINTS),
        FlightMode("LOITER", 5, Behaviour.HOLD),
        FlightMode("RTL", 6, Behaviour.RETURN, can_arm=False),
        FlightMode("LAND", 9, Behaviour.LAND, can_arm=False),
        FlightMode("POSHOLD", 16, Behaviour.HOLD),
        FlightMode("BRAKE", 17, Behaviour.HOLD, can_arm=False),
    )
}
"""ArduCopter's Mode::Number."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a setpoint is clipped to, m/s and degrees a second."""

    horizontal_m_s: float
    up_m_s: float
    down_m_s: float
    yaw_rate_deg_s: float


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
        limits: on setpoints.
        takeoff_speed_m_s, landing_speed_m_s, cruise_m_s: of its own manoeuvres.
        return_height_m: at which it flies home.
        spool_up_s: from arming until it can lift off.
        disarm_landed_s: from touching down until it disarms itself.
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
    takeoff_speed_m_s: float
    landing_speed_m_s: float
    cruise_m_s: float
    return_height_m: float
    spool_up_s: float
    disarm_landed_s: float
    unfit_text: str
    parameters: dict[str, float]
    message_rates_hz: dict[str, float]
    home: tuple[float, float, float] = (47.397742, 8.545594, 488.0)

    def mode_of(self, custom_mode: int) -> FlightMode | None:
        """Return the mode with this number, None if it is not simulated."""
        return next((m for m in self.modes.values() if m.custom_mode == custom_mode), None)


def _rates_hz(attitude: float, position: float) -> dict[str, float]:
    return {
        "HEARTBEAT": 1.0,
        "SYS_STATUS": 1.0,
        "ATTITUDE": attitude,
        "LOCAL_POSITION_NED": position,
        "GLOBAL_POSITION_INT": 10.0,
        "EXTENDED_SYS_STATE": 5.0,
    }


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
    takeoff_speed_m_s=1.5,
    landing_speed_m_s=0.7,
    cruise_m_s=5.0,
    return_height_m=30.0,
    spool_up_s=1.0,
    disarm_landed_s=2.0,
    unfit_text="Arming denied: Resolve system health failures first",
    parameters=PX4_PARAMETERS,
    message_rates_hz=_rates_hz(attitude=100.0, position=30.0),
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
    takeoff_speed_m_s=2.5,
    landing_speed_m_s=0.5,
    cruise_m_s=10.0,
    return_height_m=15.0,
    spool_up_s=2.0,
    disarm_landed_s=1.0,
    unfit_text="Arm: Need Position Estimate",
    parameters=ARDUCOPTER_PARAMETERS,
    message_rates_hz=_rates_hz(attitude=50.0, position=50.0),
    home=(-35.363262, 149.165237, 584.0),
)
"""ArduCopter 4.6.3 with default parameters."""
