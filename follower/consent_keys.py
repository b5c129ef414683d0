"""Consent by the terminal: a line is an order."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TextIO

from follower.supervisor import Order

HELP = "Enter: follow   w, Enter: withdraw consent, which lets go"
_ORDERS = {"": Order.GIVE, "w": Order.WITHDRAW}


class ConsentKeys:
    """Reads orders from a terminal on a thread of its own, until the program ends.

    Args:
        lines: the terminal's input; is left alone unless it is a terminal.
        give_order: takes each order; called on that thread.
    """

    def __init__(self, lines: TextIO, give_order: Callable[[Order], None]) -> None:
        self._lines = lines
        self._give_order = give_order

    def start(self) -> bool:
        """Begin to read; whether there is somebody who can type."""
        if not self._lines.isatty():
            return False
        threading.Thread(target=self.read, name="consent keys", daemon=True).start()
        return True

    def read(self) -> None:
        """Pass on one order after the other until the input ends; any other line is none."""
        for line in self._lines:
            order = _ORDERS.get(line.strip().lower())
            if order is not None:
                self._give_order(order)
