"""One browser that is connected."""

from __future__ import annotations

import asyncio
import secrets
from collections import deque

_MOST_ANSWERS = 32


class Client:
    """What a browser is to be told next: the newest of each kind, and answers to its requests.

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
        """Say this in place of what is still waiting of its kind."""
        self._newest.pop(kind, None)
        self._newest[kind] = text
        self._something.set()

    def answer(self, text: str) -> None:
        """Say this as well."""
        self._answers.append(text)
        self._something.set()

    async def next(self) -> list[str]:
        """Wait for something to say, and return it."""
        await self._something.wait()
        self._something.clear()
        texts = [*self._answers, *self._newest.values()]
        self._answers.clear()
        self._newest.clear()
        return texts
