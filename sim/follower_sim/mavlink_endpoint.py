"""Bytes in, messages out, and the other way round: one end of a MAVLink 2 link."""

from __future__ import annotations

from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower_control.transport import Transport
from follower_sim.faults import Faults
from follower_sim.plain_message import FRAME_BYTES, packed, plain_message


class MavlinkEndpoint:
    """Encodes and decodes for one system, and loses what `faults` tells it to lose.

    Args:
        transport: carries the bytes.
        system, component: what messages are signed with as their source.
        faults: read at every packet.
        rng: decides which packets are lost.
    """

    def __init__(
        self,
        transport: Transport,
        system: int,
        component: int,
        faults: Faults,
        rng: np.random.Generator,
    ) -> None:
        self._transport = transport
        self._codec = mavlink.MAVLink(None, system, component)
        self._codec.robust_parsing = True
        self._faults = faults
        self._rng = rng

    def receive(self) -> list[Any]:
        """Return the messages that have arrived; broken ones are left out."""
        data = self._transport.receive()
        if not data:
            return []
        return [message for message in self._messages(data) if self._hears(message)]

    def _messages(self, data: bytes) -> list[Any]:
        """Return the messages in the data, the short way as long as they are plain."""
        messages: list[Any] = []
        while not self._codec.buf_len() and (message := plain_message(data)) is not None:
            messages.append(message)
            data = data[message.get_header().mlen + FRAME_BYTES :]
        return messages + (self._codec.parse_buffer(data) or [] if data else [])

    def send(self, message: Any) -> None:
        """Send one message."""
        data = packed(message, self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        if not self._faults.silent and not self._lost(self._faults.drop_sent):
            self._transport.send(data)

    def _hears(self, message: Any) -> bool:
        if message.get_type() == "BAD_DATA":
            return False
        return not self._faults.deaf and not self._lost(self._faults.drop_received)

    def _lost(self, probability: float) -> bool:
        return probability > 0 and float(self._rng.random()) < probability
