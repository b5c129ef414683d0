"""One MAVLink component of ours: who it is, and its own count of what it sends."""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

_CHUNK = 50


class Endpoint:
    """Sends messages as one component of a system.

    Args:
        system: MAVLink system id.
        component: MAVLink component id.
        send: takes packed messages.
    """

    def __init__(self, system: int, component: int, send: Callable[[bytes], None]) -> None:
        self.system = system
        self.component = component
        self._codec = mavlink.MAVLink(None, system, component)
        self._send = send
        self._texts = 0

    def send(self, message: Any) -> None:
        """Pack and send a message."""
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        self._send(data)

    def is_for(self, message: Any) -> bool:
        """Whether a message is addressed to this component and no other."""
        return (message.target_system, message.target_component) == (self.system, self.component)

    def acknowledge(self, command: Any, result: int) -> None:
        """Answer a COMMAND_LONG or COMMAND_INT with a MAV_RESULT."""
        sender = command.get_srcSystem(), command.get_srcComponent()
        self.send(mavlink.MAVLink_command_ack_message(command.command, result, 0, 0, *sender))

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Send a line for the pilot to read; one of more than 50 bytes goes in parts.

        A part that is not full is the last one, if need be an empty one.
        """
        data = text.encode()
        if len(data) <= _CHUNK:
            self.send(mavlink.MAVLink_statustext_message(severity, data))
            return
        self._texts = self._texts % 0xFFFF + 1
        for number, at in enumerate(range(0, len(data) + 1, _CHUNK)):
            part = data[at : at + _CHUNK]
            self.send(mavlink.MAVLink_statustext_message(severity, part, self._texts, number))
