"""MAV_CMD_*: what the simulated autopilot does when told, and what it answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower_sim.flight_controller import FlightController
from follower_sim.telemetry import Telemetry

_FORCE = 21196.0
_ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
_UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED

Params = Sequence[float]


class Commands:
    """Carries out COMMAND_LONG and COMMAND_INT.

    Args:
        controller: obeys.
        telemetry: sends what is asked for.
        send: sends a message.
    """

    def __init__(
        self, controller: FlightController, telemetry: Telemetry, send: Callable[[Any], None]
    ) -> None:
        self._controller = controller
        self._telemetry = telemetry
        self._send = send
        px4 = controller.firmware.name == "px4"
        self._refused = (
            mavlink.MAV_RESULT_TEMPORARILY_REJECTED if px4 else mavlink.MAV_RESULT_FAILED
        )
        self._handlers: dict[int, Callable[[Params], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: lambda _: self._enter("LAND"),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _: self._enter("RTL"),
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: lambda p: self._request(_whole(p[0])),
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda _: self._request(
                mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
            ),
        }

    def run(self, command: int, params: Params) -> int:
        """Carry out a command with its seven parameters; return the MAV_RESULT."""
        handler = self._handlers.get(command)
        return int(_UNSUPPORTED if handler is None else handler(params))

    def set_mode(self, custom_mode: int) -> int:
        """Change to the mode with this number; return the MAV_RESULT."""
        mode = self._controller.firmware.mode_of(custom_mode)
        return self._result(mode is not None and self._controller.set_mode(mode))

    def _result(self, accepted: bool) -> int:
        return int(_ACCEPTED if accepted else self._refused)

    def _enter(self, name: str) -> int:
        return self._result(self._controller.set_mode(self._controller.firmware.modes[name]))

    def _arm_disarm(self, params: Params) -> int:
        force = params[1] == _FORCE
        act = self._controller.arm if params[0] == 1.0 else self._controller.disarm
        return self._result(act(force))

    def _take_off(self, params: Params) -> int:
        return self._result(self._controller.take_off(params[6]))

    def _do_set_mode(self, params: Params) -> int:
        base, main, sub = (_whole(p) for p in params[:3])
        if not base & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return int(_UNSUPPORTED)
        if self._controller.firmware.name == "px4":
            return self.set_mode((main & 0xFF) << 16 | (sub & 0xFF) << 24)
        return self.set_mode(main)

    def _set_message_interval(self, params: Params) -> int:
        known = self._telemetry.set_interval(_whole(params[0]), params[1])
        return int(_ACCEPTED if known else mavlink.MAV_RESULT_FAILED)

    def _request(self, message_id: int) -> int:
        message = self._telemetry.on_request(message_id)
        if message is None:
            return int(_UNSUPPORTED)
        self._send(message)
        return int(_ACCEPTED)


def _whole(number: float) -> int:
    """Return the integer that a float parameter carries, -1 if it carries none."""
    return int(number) if math.isfinite(number) else -1
