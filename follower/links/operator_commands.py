"""Commands of operators to our own component: what repeats an earlier one is known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

CONSENT_COMMAND = int(mavlink.MAV_CMD_USER_1)
_SAME_WITHIN_S = 1.0
_REPEATS_WITHIN_S = 10.0
_OVERTAKEN_WITHIN_S = 2.0
_SEQUENCES = 256
_MOST_WAITING = 16
_MOST_KNOWN = 64
_Key: TypeAlias = tuple[int, float, int, int]
_Arrival: TypeAlias = tuple[float, int]
"""When a packet came, and its sequence number."""
KeyT = TypeVar("KeyT")


@dataclass(frozen=True, slots=True)
class OperatorCommand:
    """One COMMAND_LONG or COMMAND_INT to our component.

    Attributes:
        command: MAV_CMD.
        value: its first parameter.
        system, component: who sent it and waits for an answer.
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
    """Collects commands to us until they are taken, and recognises repeated ones.

    A withdrawal of consent is never taken for a repeated one, nor left out where many wait: another
    operator may have consented since the same one before.
    """

    def __init__(self) -> None:
        self._waiting: list[OperatorCommand] = []
        self._received: dict[_Key, _Arrival] = {}
        self._withdrawn: dict[tuple[int, int], _Arrival] = {}

    def receive(self, message: Any, now_s: float) -> None:
        """Take a COMMAND_LONG or COMMAND_INT whose target we are, at a time in seconds."""
        key = (message.command, message.param1, message.get_srcSystem(), message.get_srcComponent())
        arrival = now_s, int(message.get_seq())
        withdraws = key[:2] == (CONSENT_COMMAND, 0.0)
        repeats = getattr(message, "confirmation", 0) > 0
        known = self._is_known(key, repeats, arrival) or self._is_late(key, arrival)
        _note(self._received, key, arrival)
        if withdraws:
            _note(self._withdrawn, key[2:], arrival)
        command = OperatorCommand(*key, is_new=withdraws or not known)
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(command)
        elif withdraws:
            self._waiting[-1] = command

    def take(self) -> Sequence[OperatorCommand]:
        """Return those since the last call."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def _is_known(self, key: _Key, repeats: bool, arrival: _Arrival) -> bool:
        """Whether a command came before: one that says so or the same packet; else the last one."""
        now_s, sequence = arrival
        before_s, known = self._received.get(key, (-math.inf, sequence))
        if repeats or known == sequence:
            return now_s - before_s <= _REPEATS_WITHIN_S
        return next(reversed(self._received)) == key and now_s - before_s <= _SAME_WITHIN_S

    def _is_late(self, key: _Key, arrival: _Arrival) -> bool:
        """Whether its sender withdrew consent after it was sent and before it came."""
        now_s, sequence = arrival
        withdrawn_s, last = self._withdrawn.get(key[2:], (-math.inf, 0))
        ago = (last - sequence) % _SEQUENCES
        return now_s - withdrawn_s <= _OVERTAKEN_WITHIN_S and ago < _SEQUENCES // 2


def _note(known: dict[KeyT, _Arrival], key: KeyT, arrival: _Arrival) -> None:
    known.pop(key, None)
    known[key] = arrival
    while len(known) > _MOST_KNOWN:
        del known[next(iter(known))]
