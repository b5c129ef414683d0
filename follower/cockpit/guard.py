"""Stands before the application and lets pass only what may come in."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from typing import Any, TypeAlias

from follower.cockpit.access import Access
from follower.cockpit.asker import address_of, asker_of, with_session
from follower.cockpit.limiters import Limiters

Scope: TypeAlias = MutableMapping[str, Any]
Event: TypeAlias = MutableMapping[str, Any]
Receive: TypeAlias = Callable[[], Awaitable[Event]]
Send: TypeAlias = Callable[[Event], Awaitable[None]]
Application: TypeAlias = Callable[[Scope, Receive, Send], Awaitable[None]]

MOST_BODY_BYTES = 65_536
_OPEN = frozenset({"/", "/api/session", "/openapi.json"})
_REQUEST = "/api/request"
_READS = frozenset({"GET", "HEAD"})
_POLICY = "; ".join(
    (
        *("default-src 'none'", "connect-src 'self'", "img-src 'self' data:", "media-src 'self'"),
        *("style-src 'nonce-{nonce}'", "script-src 'nonce-{nonce}'", "base-uri 'none'"),
        *("form-action 'none'", "frame-ancestors 'none'"),
    )
)
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"x-frame-options", b"DENY"),
)
_PERMANENT = (b"cache-control", b"no-store")


class RefusedError(Exception):
    """A request is refused.

    Attributes:
        code: of HTTP.
        words: why.
    """

    def __init__(self, code: int, words: str) -> None:
        super().__init__(words)
        self.code = code
        self.words = words


class Guard:
    """Checks host, origin, token, kind and length of everything.

    Args:
        inside: the application.
        access: judges.
        guesses: how often each one may show a wrong token.
        writes: how often each one may ask for anything by POST. What an operator asks for is
            counted behind, where it is known whether it is a stop.
        nonce: that the page's own script and style carry.
    """

    def __init__(
        self,
        inside: Application,
        access: Access,
        guesses: Limiters,
        writes: Limiters,
        nonce: str,
    ) -> None:
        self._inside = inside
        self._access = access
        self._guesses = guesses
        self._writes = writes
        policy = _POLICY.format(nonce=nonce).encode()
        self._headers = (*_HEADERS, _PERMANENT, (b"content-security-policy", policy))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request or connection, as ASGI has it."""
        if scope["type"] not in ("http", "websocket"):
            await self._inside(scope, receive, send)
            return
        try:
            scope = self._checked(scope)
        except RefusedError as refusal:
            await self._refuse(scope, refusal, send)
            return
        if scope["type"] == "websocket":
            await self._inside(scope, receive, send)
            return
        await self._inside(scope, _limited(receive), self._with_headers(send))

    def _checked(self, scope: Scope) -> Scope:
        """Return a request that may come in, with its session."""
        headers = _headers_of(scope)
        if not self._access.is_our_host(headers):
            raise RefusedError(421, "this is not the host's name; see cockpit.names")
        if not self._access.is_our_origin(headers):
            raise RefusedError(403, "another web site may not use this cockpit")
        session = self._access.session_of(headers)
        if session is not None:
            scope = with_session(scope, session)
        elif self._access.needs_token and scope["path"] not in _OPEN:
            self._check_token(scope, headers)
        if scope["type"] == "http" and scope["method"] not in _READS:
            self._check_write(scope, headers)
        return scope

    def _check_token(self, scope: Scope, headers: Mapping[str, str]) -> None:
        """Whoever showed too many wrong tokens is not even told whether this one is right."""
        if not self._access.shows_token(headers):
            raise RefusedError(401, "show the token first")
        guesses = self._guesses[address_of(scope)]
        if guesses.is_used_up:
            raise RefusedError(429, "slower, please")
        if not self._access.is_token_right(headers):
            guesses.allows()
            raise RefusedError(401, "show the token first")

    def _check_write(self, scope: Scope, headers: Mapping[str, str]) -> None:
        """A foreign page's form cannot send JSON without asking first, which we never allow."""
        if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            raise RefusedError(415, "send application/json")
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MOST_BODY_BYTES:
            raise RefusedError(413, f"send at most {MOST_BODY_BYTES} bytes")
        if scope["path"] != _REQUEST and not self._writes[asker_of(scope)].allows():
            raise RefusedError(429, "slower, please")

    async def _refuse(self, scope: Scope, refusal: RefusedError, send: Send) -> None:
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal.words})
            return
        body = f'{{"detail":"{refusal.words}"}}'.encode()
        headers = [(b"content-type", b"application/json"), *self._headers]
        headers.append((b"content-length", str(len(body)).encode()))
        if refusal.code == 401:
            headers.append((b"www-authenticate", b"Bearer"))
        start = {"type": "http.response.start", "status": refusal.code, "headers": headers}
        await send(start)
        await send({"type": "http.response.body", "body": body})

    def _with_headers(self, send: Send) -> Send:
        async def wrapped(event: Event) -> None:
            if event["type"] == "http.response.start":
                own = {name for name, _ in event["headers"]}
                more = [(name, value) for name, value in self._headers if name not in own]
                event = {**event, "headers": [*event["headers"], *more]}
            await send(event)

        return wrapped


def _headers_of(scope: Scope) -> dict[str, str]:
    """Return the headers; one that is told twice is refused, for who knows which one counts."""
    headers: dict[str, str] = {}
    for raw_name, raw_value in scope["headers"]:
        name = raw_name.decode("latin-1").lower()
        if name in headers and name in ("host", "origin", "authorization", "content-length"):
            raise RefusedError(400, f"{name} is there twice")
        headers[name] = raw_value.decode("latin-1")
    return headers


def _limited(receive: Receive) -> Receive:
    """Cut off a body that is longer than it said."""
    received = 0

    async def wrapped() -> Event:
        nonlocal received
        event = await receive()
        received += len(event.get("body", b""))
        if received > MOST_BODY_BYTES:
            return {"type": "http.disconnect"}
        return event

    return wrapped
