"""Commands that are addressed to us: an operator's consent, as a ground station sends it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from pymavlink.dialects.v20 import common as mavlink

CONSENT_COMMAND = int(mavlink.MAV_CMD_USER_1)
_SAME_WITHIN_S = 1.0
_REPEATS_WITHIN_S = 10.0
_OVERTAKEN_WITHIN_S = 2.0
_SEQUENCES = 256
_MOST_WAITING = 16
_MOST_KNOWN = 64
_Key: TypeAlias = tuple[int, float, int, int]
KeyT = TypeVar("KeyT")
_Heard: TypeAlias = tuple[float, int]
"""When a packet came, and its sequence number."""


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """One COMMAND_LONG or COMMAND_INT to our component.

    Attributes:
        command: MAV_CMD.
        value: its first parameter.
        system, component: who sent it and wants an answer.
        is_new: False for one that repeats an earlier one, because its answer got lost or the
            network doubled it, and for one that its sender's withdrawal overtook on the way: it is
            answered and not carried out.
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
        self._heard: dict[_Key, _Heard] = {}
        self._withdrawn: dict[tuple[int, int], _Heard] = {}

    def hear(self, message: Any, now_s: float) -> None:
        """Take a COMMAND_LONG or COMMAND_INT whose target we are."""
        key = (message.command, message.param1, message.get_srcSystem(), message.get_srcComponent())
        heard = now_s, int(message.get_seq())
        withdraws = key[:2] == (CONSENT_COMMAND, 0.0)
        repeats = getattr(message, "confirmation", 0) > 0
        is_new = withdraws or not (self._is_known(key, repeats, heard) or self._is_late(key, heard))
        _note(self._heard, key, heard)
        if withdraws:
            _note(self._withdrawn, key[2:], heard)
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(OperatorCommand(*key, is_new))
        elif withdraws:
            self._waiting[-1] = OperatorCommand(*key, is_new)

    def take(self) -> Sequence[OperatorCommand]:
        """Return those since the last call."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def _is_known(self, key: _Key, repeats: bool, heard: _Heard) -> bool:
        """Whether a command came before: one that says so or the same packet; else the last one."""
        now_s, sequence = heard
        before_s, known = self._heard.get(key, (-math.inf, sequence))
        if repeats or known == sequence:
            return now_s - before_s <= _REPEATS_WITHIN_S
        return next(reversed(self._heard)) == key and now_s - before_s <= _SAME_WITHIN_S

    def _is_late(self, key: _Key, heard: _Heard) -> bool:
        """Whether its sender withdrew consent after it was sent and before it came."""
        now_s, sequence = heard
        withdrawn_s, last = self._withdrawn.get(key[2:], (-math.inf, 0))
        ago = (last - sequence) % _SEQUENCES
        return now_s - withdrawn_s <= _OVERTAKEN_WITHIN_S and ago < _SEQUENCES // 2


def _note(known: dict[KeyT, _Heard], key: KeyT, heard: _Heard) -> None:
    known.pop(key, None)
    known[key] = heard
    while len(known) > _MOST_KNOWN:
        del known[next(iter(known))]
