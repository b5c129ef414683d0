"""One browser's WebSocket."""

import asyncio
import contextlib
import json
from typing import Any

from fastapi import WebSocket, WebSocketDisconnect
from pydantic import ValidationError

from follower.ui.cockpit.asgi_guard import RateLimiter
from follower.ui.cockpit.detections import Objects
from follower.ui.cockpit.hub import Client, Hub
from follower.ui.cockpit.requests import REQUESTS, is_release
from follower_vision.clock import Clock

_RATE_HZ, _BURST = 40.0, 80
_MOST_CHARACTERS = 2048
_MOST_OPEN = 16
_STUCK_S = 10.0
"""A browser that reads nothing for so long is disconnected."""
_IN_CONTROL = json.dumps(
    {"kind": "told", "accepted": False, "text": "another client is in control; it has to leave"}
)
_POLICY_VIOLATION, _TRY_LATER = 1008, 1013


class ProtocolViolationError(ValueError):
    """A client sent something that our page never sends."""


class WebSocketSession:
    """Sends the flight's state to one client and takes its requests, until either side ends it.

    Args:
        socket: not accepted yet.
        hub: of all clients.
        objects: what may be tapped, None without a detector.
        clock: this process's.
    """

    def __init__(self, socket: WebSocket, hub: Hub, objects: Objects | None, clock: Clock) -> None:
        self._socket = socket
        self._hub = hub
        self._objects = objects
        self._limiter = RateLimiter(_RATE_HZ, _BURST, clock)
        self._asking: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Talk until one side ends it."""
        await self._socket.accept()
        client = self._hub.join()
        if client is None:
            await self._socket.close(_TRY_LATER, "too many clients")
            return
        teller = asyncio.create_task(self._tell(client))
        hearer = asyncio.create_task(self._hear(client))
        try:
            await asyncio.wait((teller, hearer), return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (teller, hearer, *self._asking):
                task.cancel()
            self._hub.leave(client)
            if self._objects is not None:
                self._objects.want(client.id, False)
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it may be closed already
            await self._socket.close(_POLICY_VIOLATION)

    async def _tell(self, client: Client) -> None:
        with contextlib.suppress(TimeoutError, RuntimeError, WebSocketDisconnect):
            while True:
                for text in await client.next():
                    async with asyncio.timeout(_STUCK_S):
                        await self._socket.send_text(text)

    async def _hear(self, client: Client) -> None:
        with contextlib.suppress(
            ProtocolViolationError, RuntimeError, WebSocketDisconnect, KeyError
        ):
            while True:
                # A KeyError stands for bytes where text was expected.
                text = await self._socket.receive_text()
                if len(text) > _MOST_CHARACTERS or not self._limiter.allows(client.id):
                    raise ProtocolViolationError("too much")
                self._take(client, _mapping(text))

    def _take(self, client: Client, message: dict[str, Any]) -> None:
        self._hub.hear(client)
        match message.get("kind"):
            case "ping":
                pass
            case "take_control":
                if not self._hub.take_control(client):
                    client.tell("told", _IN_CONTROL)
            case "objects" if self._objects is not None:
                self._objects.want(client.id, message.get("on") is True)
            case _:
                self._ask(client, message)

    def _ask(self, client: Client, message: dict[str, Any]) -> None:
        """Ask the flight; a second question need not wait for the first one's answer."""
        number = message.pop("id", None)
        if not isinstance(number, int):
            raise ProtocolViolationError("no number to answer to")
        task = asyncio.create_task(self._asked(client, message, number))
        self._asking.add(task)
        task.add_done_callback(self._asking.discard)

    async def _asked(self, client: Client, message: dict[str, Any], number: int) -> None:
        answer = await self._answer(client, message)
        client.answer(json.dumps({"kind": "answer", "id": number, **answer}))

    async def _answer(self, client: Client, message: dict[str, Any]) -> dict[str, Any]:
        seen_s = _time(message.pop("at", None))
        try:
            request = REQUESTS.validate_python(message)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False, include_input=False)[0]
            return {"accepted": False, "text": f"no request: {first['msg']}"}
        if not self._hub.may(client.id, request):
            return {"accepted": False, "text": "another client is in control; you watch"}
        if len(self._asking) > _MOST_OPEN and not is_release(request):
            return {"accepted": False, "text": "too much is asked at once"}
        late = None if seen_s is None else self._hub.lateness(request, seen_s)
        if late is not None:
            return {"accepted": False, "text": late}
        return await self._hub.ask(request, "cockpit")


def _time(value: Any) -> float | None:
    """Return a time in seconds that a client sent, None if it is none."""
    try:
        return float(value) if isinstance(value, int | float) else None
    except OverflowError:
        return None


def _mapping(text: str) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise ProtocolViolationError("no JSON") from None
    if not isinstance(message, dict):
        raise ProtocolViolationError("no message")
    return message
