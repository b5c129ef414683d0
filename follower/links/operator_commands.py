"""Commands that are addressed to us: an operator's consent, as a ground station sends it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

CONSENT_COMMAND = int(mavlink.MAV_CMD_USER_1)
_SAME_WITHIN_S = 1.0
_REPEATS_WITHIN_S = 10.0
_MOST_WAITING = 16


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """One COMMAND_LONG or COMMAND_INT to our component.

    Attributes:
        command: MAV_CMD.
        value: its first parameter.
        system, component: who sent it and wants an answer.
        is_new: False for one that repeats an earlier one, because its answer got lost or the
            network doubled it: it is answered and not carried out again.
    """

    command: int
    value: float
    system: int
    component: int
    is_new: bool = True


class OperatorCommands:
    """Collects commands to us until somebody takes them, and knows repeated ones."""

    def __init__(self) -> None:
        self._waiting: list[OperatorCommand] = []
        self._last: tuple[float, tuple[float, ...]] | None = None

    def hear(self, message: Any, now_s: float) -> None:
        """Take a COMMAND_LONG or COMMAND_INT whose target we are."""
        key = (message.command, message.param1, message.get_srcSystem(), message.get_srcComponent())
        repeats = getattr(message, "confirmation", 0) > 0
        within_s = _REPEATS_WITHIN_S if repeats else _SAME_WITHIN_S
        known = self._last is not None and self._last[1] == key
        is_new = not known or self._last is None or now_s - self._last[0] > within_s
        self._last = now_s, key
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(OperatorCommand(*key, is_new))

    def take(self) -> Sequence[OperatorCommand]:
        """Return those since the last call."""
        waiting, self._waiting = self._waiting, []
        return waiting
