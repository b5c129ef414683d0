"""The Enter key as the operator's consent."""

from __future__ import annotations

import select
from typing import TextIO

from follower.situation import Order


class Keyboard:
    """Looks at a terminal without ever waiting for it.

    Enter alone consents. Whatever else is typed withdraws, be it "n", "stop" or a slip: who types
    in a hurry wants the vehicle to end what it does. What is no terminal gives no orders: a
    service's input is at its end from the start.

    Args:
        stream: standard input.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream: TextIO | None = stream if _is_terminal(stream) else None

    def order(self) -> Order:
        """Return what was typed since last time."""
        order = Order.NONE
        while self._stream is not None and select.select([self._stream], [], [], 0)[0]:
            line = self._stream.readline()
            if not line:
                self._stream = None
            elif line.strip():
                order = Order.WITHDRAW
            elif order is Order.NONE:
                order = Order.GIVE
        return order


def _is_terminal(stream: TextIO) -> bool:
    try:
        return stream.isatty()
    except ValueError:
        return False
