"""Gusts for the simulator of a real autopilot, which has none that a vehicle feels."""

import math
from collections.abc import Collection

from pymavlink.dialects.v20 import common as mavlink

from follower.simulation.sitl.programs import SitlProgram
from follower_control.common.transport import Transport
from follower_sim.world.world import World
from follower_vision.clock import Clock

_GROUND_STATION = 255
_EVERY_S = 0.2


class Gusts:
    """Tells an autopilot's simulator in flight how the scenario's air moves now.

    It sets the parameters of the wind, as a ground station. ArduPilot's own turbulence is drawn
    anew in each step, in any direction, and moves nothing. Upwards and downwards the air stands
    still.

    Args:
        program: what flies; one that cannot be told is told nothing.
        given: parameters that the user set: what they say of the wind stays.
        world: its scenario's start says how it is turned onto the autopilot's.
        transport: goes to the autopilot.
        clock: the flight's.
    """

    def __init__(
        self,
        program: SitlProgram,
        given: Collection[str],
        world: World,
        transport: Transport,
        clock: Clock,
    ) -> None:
        self._program = program
        self._given = given
        self._turn = math.radians(world.scenario.start.heading_deg)
        self._wind = world.wind
        self._transport = transport
        self._clock = clock
        self._mavlink = mavlink.MAVLink(None, srcSystem=_GROUND_STATION)
        self._next_s = -math.inf

    def step(self, vehicle_id: int | None) -> None:
        """Send how the air moves now, if it is time; None is a vehicle that has not spoken yet."""
        now_s = self._clock.now()
        if vehicle_id is None or now_s < self._next_s:
            return
        self._next_s = now_s + _EVERY_S
        north, east, _ = self._wind.velocity_m_s(now_s)
        cos, sin = math.cos(self._turn), math.sin(self._turn)
        air = self._program.air(cos * north + sin * east, cos * east - sin * north)
        for name in air.keys() - self._given:
            message = mavlink.MAVLink_param_set_message(
                vehicle_id, 1, name.encode(), air[name], mavlink.MAV_PARAM_TYPE_REAL32
            )
            self._transport.send(message.pack(self._mavlink))
