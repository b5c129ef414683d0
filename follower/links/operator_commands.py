"""Commands that are addressed to us: an operator's consent, as a ground station sends it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import common as mavlink

CONSENT_COMMAND = int(mavlink.MAV_CMD_USER_1)
_SAME_WITHIN_S = 1.0
_REPEATS_WITHIN_S = 10.0
_MOST_WAITING = 16
_MOST_KNOWN = 64
_Key: TypeAlias = tuple[int, float, int, int]


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
    """Collects commands to us until somebody takes them, and knows repeated ones.

    A withdrawal is never taken for a repeated one, nor left out where many wait: somebody else may
    have consented since the same one before.
    """

    def __init__(self) -> None:
        self._waiting: list[OperatorCommand] = []
        self._heard_s: dict[_Key, float] = {}

    def hear(self, message: Any, now_s: float) -> None:
        """Take a COMMAND_LONG or COMMAND_INT whose target we are."""
        key = (message.command, message.param1, message.get_srcSystem(), message.get_srcComponent())
        withdraws = key[:2] == (CONSENT_COMMAND, 0.0)
        repeats = getattr(message, "confirmation", 0) > 0
        is_new = withdraws or not self._is_known(key, repeats, now_s)
        self._note(key, now_s)
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(OperatorCommand(*key, is_new))
        elif withdraws:
            self._waiting[-1] = OperatorCommand(*key, is_new)

    def take(self) -> Sequence[OperatorCommand]:
        """Return those since the last call."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def _is_known(self, key: _Key, repeats: bool, now_s: float) -> bool:
        """Whether a command came before: one that says so, among all; else the last one."""
        if repeats:
            return now_s - self._heard_s.get(key, -math.inf) <= _REPEATS_WITHIN_S
        last = next(reversed(self._heard_s), None)
        return last == key and now_s - self._heard_s[key] <= _SAME_WITHIN_S

    def _note(self, key: _Key, now_s: float) -> None:
        self._heard_s.pop(key, None)
        self._heard_s[key] = now_s
        while len(self._heard_s) > _MOST_KNOWN:
            del self._heard_s[next(iter(self._heard_s))]
