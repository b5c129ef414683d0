"""mavsdk's stream of setpoints, held on a short leash."""

from __future__ import annotations

import contextlib
import math
import struct
import threading
from collections.abc import Callable

from mavsdk.plugins.offboard import Offboard, OffboardError, VelocityBodyYawspeed
from mavsdk.system import System
from pymavlink.dialects.v20 import common as mavlink

from follower.links.packets import message_id_of
from follower_control.setpoint import HOLD, VelocitySetpoint
from follower_vision.clock import Clock

_STOP_AFTER_S = 0.1
_HEADER, _VELOCITY, _YAW_RATE = 10, 16, 44
"""Where a packet's payload begins, and in it a setpoint's velocity and yaw rate, bytes."""


def stands_still(packet: bytes) -> bool:
    """Whether a SET_POSITION_TARGET_LOCAL_NED asks for no velocity and no turn.

    Args:
        packet: whole, of MAVLink 2, which leaves zeros out at a payload's end.
    """
    payload = packet[_HEADER : _HEADER + packet[1]].ljust(_YAW_RATE + 4, b"\0")
    velocity = struct.unpack_from("<3f", payload, _VELOCITY)
    return not any((*velocity, *struct.unpack_from("<f", payload, _YAW_RATE)))


class MavsdkStream:
    """Sends setpoints through mavsdk, which repeats the last one at 20 Hz until it is told not to.

    Left alone it would go on flying the last velocity while the control loop stands still. So:
    `watch`, called on another thread, sets zero when no setpoint has come for `stall_s` and 0.1 s
    later calls `stop`, which ends the stream and asks for Hold or BRAKE. A pilot who has taken
    over keeps his mode: then the stream ends alone. And `passes`, asked for every packet that
    leaves, lets no setpoint through that the control loop has not renewed in time, even while
    `watch` waits for the processor.

    A plugin that still waits for an answer must not be destroyed: MAVSDK 4.1.0 then calls a
    function that is gone, and the process crashes.

    Args:
        system: mavsdk's.
        clock: runs by itself.
        stall_s: a loop that is silent for so long stands still.
        obeys: whether the vehicle is in the mode that flies setpoints, as far as is known.

    Attributes:
        stalls: how often the control loop stood still.
    """

    def __init__(
        self, system: System, clock: Clock, stall_s: float, obeys: Callable[[], bool]
    ) -> None:
        self._system = system
        self._clock = clock
        self._stall_s = stall_s
        self._obeys = obeys
        self._lock = threading.Lock()
        self._offboard: Offboard | None = None
        self._set_s = float("-inf")
        self._zeroed = False
        self._stopping: list[Offboard] = []
        self.stalls = 0

    @property
    def busy(self) -> bool:
        """Whether a stop still waits for its answer."""
        return bool(self._stopping)

    def set(self, setpoint: VelocitySetpoint, asked_s: float) -> None:
        """Send a setpoint now; the stream goes on with it.

        The hold with which a loop comes back from a stall is not needed, if the vehicle has left
        the mode meanwhile: the last word there was zero.

        Args:
            setpoint: what is asked for.
            asked_s: since when.
        """
        with self._lock:
            stalled, self._zeroed = self._zeroed, False
            self._set_s = asked_s
            if not (stalled and setpoint == HOLD and not self._obeys()):
                self._put(setpoint)

    def end(self) -> None:
        """End the stream; the vehicle's mode stays."""
        with self._lock:
            self._destroy()

    def watch(self) -> None:
        """Bring the vehicle to rest if the control loop stands still."""
        with self._lock:
            silent_s = self._clock.now() - self._set_s
            if self._offboard is None or silent_s <= self._stall_s:
                return
            if not self._zeroed:
                self.stalls += 1
                self._zeroed = True
                self._put(HOLD)
            elif silent_s > self._stall_s + _STOP_AFTER_S:
                self._stop(self._offboard)

    def passes(self, packet: bytes) -> bool:
        """Whether a packet of mavsdk's may leave."""
        if message_id_of(packet) != mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED:
            return True
        if self._offboard is None:
            return False
        if self._zeroed:
            # mavsdk's own thread may have made one of the old velocity a moment before.
            return stands_still(packet)
        return self._clock.now() - self._set_s <= self._stall_s

    def _put(self, setpoint: VelocitySetpoint) -> None:
        if self._offboard is None:
            self._offboard = Offboard(self._system)
        forward, right, down, yaw_rate = setpoint.values
        velocity = VelocityBodyYawspeed(forward, right, down, math.degrees(yaw_rate))
        # What it cannot send now is a lost packet, as with the other link.
        with contextlib.suppress(OffboardError):
            self._offboard.set_velocity_body(velocity)

    def _stop(self, offboard: Offboard) -> None:
        if not self._obeys():
            self._destroy()
            return
        self._offboard = None
        self._stopping.append(offboard)
        offboard.stop_async(lambda _result, _data: self._stopping.remove(offboard))

    def _destroy(self) -> None:
        offboard, self._offboard = self._offboard, None
        if offboard is not None:
            offboard.destroy()
