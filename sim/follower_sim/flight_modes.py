"""Flight modes with the numbers that heartbeats carry."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto


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
