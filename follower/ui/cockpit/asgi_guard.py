"""Stands before the application: checks each request and limits what one client may ask for."""

import asyncio
import ipaddress
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from follower.ui.cockpit.auth import AccessControl
from follower_vision.clock import Clock

_IPV6_PREFIX = 64
"""Whoever has one IPv6 address has all of its network."""
_SESSION = "follower.session"
_MOST_BUCKETS = 256
_SHARED = ""
MOST_BODY_BYTES = 65_536
_BODY_WITHIN_S = 10.0
"""Who does not send what it announced would keep a place that others want."""
_OPEN = frozenset({"/", "/api/session", "/openapi.json"})
_REQUEST = "/api/request"
_ASKS_TOKEN = {"www-authenticate": "Bearer"}
_READS = frozenset({"GET", "HEAD"})
_ONLY_ONCE = ("host", "origin", "authorization", "content-length")
_POLICY = (
    "default-src 'none'; connect-src 'self'; img-src 'self' data:; media-src 'self'; "
    "style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}


def address_of(scope: Mapping[str, Any]) -> str:
    """Return the network address that a request comes from; by IPv6 its whole network."""
    client = scope.get("client")
    return network_of(client[0]) if client else ""


def client_identity(scope: Mapping[str, Any]) -> str:
    """Return who asks: the session where there is one, else the address."""
    return str(scope.get(_SESSION) or address_of(scope))


def network_of(address: str) -> str:
    """Return what an address is counted as.

    An IPv4 address that was written as an IPv6 one is itself.
    """
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, ipaddress.IPv4Address):
        return str(found)
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((found, _IPV6_PREFIX), strict=False))


class RateLimiter:
    """A token bucket for each client, so that none uses up another one's.

    At most 256 buckets are kept; one that is full again is forgotten. While there are more clients
    than that, newcomers share one bucket.

    Args:
        rate_hz: that each bucket is filled at.
        burst: that a full bucket holds.
        clock: this process's.
    """

    def __init__(self, rate_hz: float, burst: int, clock: Clock) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, float(burst), clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def is_used_up(self, client: str) -> bool:
        """Whether `allows` would say no."""
        return self._left(self._key(client)) < 1

    def allows(self, client: str) -> bool:
        """Whether it may happen once more now."""
        key = self._key(client)
        left = self._left(key)
        self._buckets[key] = (left - 1 if left >= 1 else left), self._clock.now()
        self._buckets.move_to_end(key)
        return left >= 1

    def _key(self, client: str) -> str:
        while self._buckets and self._left(next(iter(self._buckets))) >= self._burst:
            self._buckets.popitem(last=False)
        known = client in self._buckets or len(self._buckets) < _MOST_BUCKETS
        return client if known else _SHARED

    def _left(self, key: str) -> float:
        now_s = self._clock.now()
        left, since_s = self._buckets.get(key, (self._burst, now_s))
        return min(self._burst, left + (now_s - since_s) * self._rate_hz)


class AsgiGuard:
    """Checks host, origin, token, kind and length of everything.

    Args:
        inside: the application.
        access: judges.
        guesses: how often each client may show a wrong token.
        writes: how often each client may ask for anything by POST. What an operator asks for is
            counted behind, where it is known whether it is a stop.
        nonce: that the page's own script and style carry.
    """

    def __init__(
        self,
        inside: ASGIApp,
        access: AccessControl,
        guesses: RateLimiter,
        writes: RateLimiter,
        nonce: str,
    ) -> None:
        self._inside = inside
        self._access = access
        self._guesses = guesses
        self._writes = writes
        self._headers = _HEADERS | {"content-security-policy": _POLICY.format(nonce=nonce)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection, as ASGI has it."""
        if scope["type"] not in ("http", "websocket"):
            await self._inside(scope, receive, send)
            return
        try:
            scope = self._checked(scope)
        except HTTPException as refusal:
            await self._refuse(refusal, scope, receive, send)
            return
        if scope["type"] == "websocket":
            await self._inside(scope, receive, send)
            return
        await self._inside(scope, _limited(receive), self._with_headers(send))

    def _checked(self, scope: Scope) -> Scope:
        """Return a request that may come in, with its session."""
        headers = _unambiguous(Headers(scope=scope))
        if not self._access.is_our_host(headers):
            raise HTTPException(421, "this is not the host's name; see cockpit.names")
        if not self._access.is_our_origin(headers):
            raise HTTPException(403, "another web site may not use this cockpit")
        session = self._access.session_of(headers)
        if session is not None:
            scope = {**scope, _SESSION: session}
        elif self._access.needs_token and scope["path"] not in _OPEN:
            self._check_token(scope, headers)
        if scope["type"] == "http" and scope["method"] not in _READS:
            self._check_write(scope, headers)
        return scope

    def _check_token(self, scope: Scope, headers: Headers) -> None:
        """After too many wrong tokens the answer does not say whether this one is right."""
        if not self._access.shows_token(headers):
            raise HTTPException(401, "show the token first", _ASKS_TOKEN)
        if self._guesses.is_used_up(address_of(scope)):
            raise HTTPException(429, "slower, please")
        if not self._access.is_token_right(headers):
            self._guesses.allows(address_of(scope))
            raise HTTPException(401, "show the token first", _ASKS_TOKEN)

    def _check_write(self, scope: Scope, headers: Headers) -> None:
        """A foreign page's form cannot send JSON without asking first, which we never allow."""
        if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            raise HTTPException(415, "send application/json")
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MOST_BODY_BYTES:
            raise HTTPException(413, f"send at most {MOST_BODY_BYTES} bytes")
        if scope["path"] != _REQUEST and not self._writes.allows(client_identity(scope)):
            raise HTTPException(429, "slower, please")

    async def _refuse(
        self, refusal: HTTPException, scope: Scope, receive: Receive, send: Send
    ) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal.detail})
            return
        headers = {**self._headers, **(refusal.headers or {})}
        response = JSONResponse({"detail": refusal.detail}, refusal.status_code, headers)
        await response(scope, receive, send)

    def _with_headers(self, send: Send) -> Send:
        async def wrapped(event: Message) -> None:
            if event["type"] == "http.response.start":
                headers = MutableHeaders(scope=event)
                for name, value in self._headers.items():
                    headers.setdefault(name, value)
            await send(event)

        return wrapped


def _unambiguous(headers: Headers) -> Headers:
    """Return headers of which none that counts is there twice: nobody knows which one counts."""
    for name in _ONLY_ONCE:
        if len(headers.getlist(name)) > 1:
            raise HTTPException(400, f"{name} is there twice")
    return headers


def _limited(receive: Receive) -> Receive:
    """Cut off a body that is longer than it said, or takes too long."""
    received, end_s = 0, asyncio.get_running_loop().time() + _BODY_WITHIN_S
    complete = False

    async def wrapped() -> Message:
        nonlocal received, complete
        try:
            async with asyncio.timeout_at(None if complete else end_s):
                event = await receive()
        except TimeoutError:
            return {"type": "http.disconnect"}
        received += len(event.get("body", b""))
        complete = not event.get("more_body", False)
        if received > MOST_BODY_BYTES:
            return {"type": "http.disconnect"}
        return event

    return wrapped


class ConnectionLimiter:
    """Who is connected, by network address.

    Args:
        most_each: connections of one address.
    """

    def __init__(self, most_each: int) -> None:
        self._most_each = most_each
        self._open: list[tuple[str, asyncio.BaseTransport]] = []

    def admits(self, transport: asyncio.BaseTransport) -> bool:
        """Whether somebody may connect once more; from then on it counts until it is closed."""
        peer = transport.get_extra_info("peername")
        address = network_of(peer[0]) if peer else ""
        self._open = [(theirs, one) for theirs, one in self._open if not one.is_closing()]
        if sum(theirs == address for theirs, _ in self._open) >= self._most_each:
            return False
        self._open.append((address, transport))
        return True


def crowded_protocol(crowd: ConnectionLimiter, first_request_s: float) -> type[H11Protocol]:
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
