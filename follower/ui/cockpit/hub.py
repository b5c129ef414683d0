"""Sends the flight's state to all clients, and the requests of one of them to the flight."""

import asyncio
import itertools
import json
import math
import secrets
from collections import deque
from collections.abc import Callable
from typing import Any

from follower.ui.cockpit.requests import OperatorRequest, ShowRecording, is_release
from follower.ui.ipc.messages import Message
from follower_vision.clock import Clock

_MOST_ANSWERS = 32
_ANSWER_S = 4.0
_SILENT_S = 5.0
"""Control of a client that says nothing for so long may be taken by another one."""
_MOST_OPEN = 100
_LATE_S = 3.0
"""Who asked by what was shown so long ago would not ask for the same now."""


class Client:
    """What is to be sent to a browser next: the newest of each kind, and answers to its requests.

    Nothing is queued for one that reads slowly but its last answers.

    Attributes:
        id: unguessable.
        heard_s: when it last said anything.
    """

    def __init__(self, heard_s: float) -> None:
        self.id = secrets.token_urlsafe(9)
        self.heard_s = heard_s
        self._newest: dict[str, str] = {}
        self._answers: deque[str] = deque(maxlen=_MOST_ANSWERS)
        self._something = asyncio.Event()

    def tell(self, kind: str, text: str) -> None:
        """Send this in place of what is still waiting of its kind."""
        self._newest.pop(kind, None)
        self._newest[kind] = text
        self._something.set()

    def answer(self, text: str) -> None:
        """Send this as well."""
        self._answers.append(text)
        self._something.set()

    async def next(self) -> list[str]:
        """Wait for something to send, and return it."""
        await self._something.wait()
        self._something.clear()
        texts = [*self._answers, *self._newest.values()]
        self._answers.clear()
        self._newest.clear()
        return texts


class Hub:
    """Knows the clients, and which one of them is in control; used on the server's loop alone.

    Args:
        page: what a client receives first.
        send: takes what goes to the flight.
        clock: this process's.
        most_clients: more are not let in.
    """

    def __init__(
        self, page: Message, send: Callable[[Message], None], clock: Clock, most_clients: int
    ) -> None:
        self.page = page
        self.state: Message = {}
        self._send = send
        self._clock = clock
        self._most_clients = most_clients
        self._clients: dict[str, Client] = {}
        self._controller: Client | None = None
        self._told_s = self._stopped_s = -math.inf
        self._numbers = itertools.count(1)
        self._open: dict[int, asyncio.Future[Message]] = {}

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._clients)

    @property
    def state_age_s(self) -> float:
        """How long ago the flight's time moved last, seconds; infinite before the first state."""
        return self._clock.now() - self._told_s

    def join(self) -> Client | None:
        """Let a client in; None if there are too many. One that is alone has control.

        Beside others it asks for it: where whoever had it has gone, following goes on by a press.
        """
        if len(self._clients) >= self._most_clients:
            return None
        client = Client(self._clock.now())
        if not self._clients:
            self._controller = client
        self._clients[client.id] = client
        client.tell("hello", _text("hello", client=client.id, page=self.page))
        client.tell("state", _text("state", **self.moment()))
        self._tell_control()
        return client

    def leave(self, client: Client) -> None:
        """Note that a client is gone; whoever is left may take control."""
        self._clients.pop(client.id, None)
        if self._controller is client:
            self._controller = None
        self._tell_control()

    def hear(self, client: Client) -> None:
        """Note that a client is there."""
        client.heard_s = self._clock.now()
        client.tell("pong", _text("pong"))
        if client is self._controller:
            self._send({"kind": "heard"})

    def take_control(self, client: Client) -> bool:
        """Give a client control if nobody else has it; return whether it has it now."""
        holder = self._controller
        silent = holder is not None and self._clock.now() - holder.heard_s > _SILENT_S
        if holder is None or silent:
            self._controller = client
            self._tell_control()
        return self._controller is client

    def may(self, client_id: str, request: OperatorRequest) -> bool:
        """Whether a client may ask for this: anybody may stop, the one in control everything."""
        if is_release(request):
            return True
        return self._controller is not None and self._controller.id == client_id

    def lateness(self, request: OperatorRequest, seen_s: float) -> str | None:
        """Say why a request is not what its sender would want now; None if it may be.

        A line that broke hands over later what was pressed before: also a consent, and after stop.

        Args:
            request: what is wanted.
            seen_s: `at` of the newest state that its sender had seen.
        """
        if is_release(request) or isinstance(request, ShowRecording):
            return None
        if seen_s <= self._stopped_s:
            return "following was stopped since you asked: ask again"
        late_s = self._clock.now() - seen_s
        return f"that came {late_s:.0f} s late: ask again" if late_s > _LATE_S else None

    async def ask(self, request: OperatorRequest, by: str) -> Message:
        """Have the flight carry out a request, and return its answer."""
        if len(self._open) >= _MOST_OPEN and not is_release(request):
            return {"accepted": False, "text": "too much is asked at once"}
        if is_release(request):
            self._stopped_s = self._clock.now()
        number = next(self._numbers)
        future: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self._open[number] = future
        message = {"kind": "request", "number": number, "request": request.model_dump(), "by": by}
        self._send(message)
        try:
            async with asyncio.timeout(_ANSWER_S):
                return await future
        except TimeoutError:
            return {"accepted": False, "text": "the flight did not answer"}
        finally:
            self._open.pop(number, None)

    def take(self, message: Message) -> None:
        """Take a message from the flight."""
        match message["kind"]:
            case "state":
                # Whoever tells of the flight may go on while its control hangs.
                if not self.state or message["state"].get("time_s") != self.state.get("time_s"):
                    self._told_s = self._clock.now()
                self.state = message["state"]
                self.tell("state", **self.moment())
            case "page":
                self.page = {**self.page, **message["page"]}
                self.tell("page", page=self.page)
            case "answer":
                future = self._open.get(message["number"])
                if future is not None and not future.done():
                    answer = {"accepted": message["accepted"], "text": message["text"]}
                    future.set_result(answer)

    def moment(self) -> Message:
        """Return the state with the time now and, once there is one, when the flight's moved."""
        told = {"told_s": self._told_s} if self.state else {}
        return {"at": self._clock.now(), **told, **self.state}

    def tell(self, kind: str, **content: Any) -> None:
        """Send to all clients."""
        text = _text(kind, **content)
        for client in self._clients.values():
            client.tell(kind, text)

    def _tell_control(self) -> None:
        taken, clients = self._controller is not None, len(self._clients)
        for client in self._clients.values():
            yours = client is self._controller
            client.tell("control", _text("control", yours=yours, taken=taken, clients=clients))


def _text(kind: str, **content: Any) -> str:
    return json.dumps({"kind": kind, **content}, allow_nan=False)
