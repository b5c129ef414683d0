"""Keeps some who connect from taking the places of all others."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

from follower.cockpit.asker import network_of


class Crowd:
    """Who is connected, by network address.

    Args:
        most_each: connections of one address.
    """

    def __init__(self, most_each: int) -> None:
        self._most_each = most_each
        self._open: dict[str, set[asyncio.BaseTransport]] = {}

    def admits(self, transport: asyncio.BaseTransport) -> bool:
        """Whether somebody may connect once more; from then on it counts until it is closed."""
        peer = transport.get_extra_info("peername")
        address = network_of(peer[0]) if peer else ""
        self._forget_closed()
        ours = self._open.setdefault(address, set())
        if len(ours) >= self._most_each:
            return False
        ours.add(transport)
        return True

    def _forget_closed(self) -> None:
        still = {
            address: {one for one in transports if not one.is_closing()}
            for address, transports in self._open.items()
        }
        self._open = {address: transports for address, transports in still.items() if transports}


def crowded_protocol(crowd: Crowd, first_request_s: float) -> type[H11Protocol]:
    """Return uvicorn's protocol for connections that a crowd admits.

    Args:
        crowd: of the server.
        first_request_s: who has asked for nothing after so long is hung up on.
    """

    class CrowdedProtocol(H11Protocol):
        """HTTP for one connection."""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            if not crowd.admits(transport):
                transport.abort()
                return
            self.loop.call_later(first_request_s, self._give_up, transport)

        def _give_up(self, transport: asyncio.Transport) -> None:
            if transport.get_protocol() is self and self.cycle is None:
                transport.abort()

    return CrowdedProtocol
