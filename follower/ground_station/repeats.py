"""Knows commands that come again because their answer got lost."""

from __future__ import annotations

from typing import Any

_SAME_WITHIN_S = 1.0
_REPEATS_WITHIN_S = 10.0
_MOST = 32


class Repeats:
    """Remembers what commands were answered with.

    A command that repeats an earlier one is answered alike and not carried out again: the same
    rectangle a second later shows something else.
    """

    def __init__(self) -> None:
        self._answers: dict[tuple[Any, ...], tuple[float, int]] = {}

    def known(self, message: Any, now_s: float) -> int | None:
        """Return the result that this command was answered with, None for a new one."""
        repeats = getattr(message, "confirmation", 0) > 0
        within_s = _REPEATS_WITHIN_S if repeats else _SAME_WITHIN_S
        answered_s, result = self._answers.get(_key(message), (float("-inf"), 0))
        return result if now_s - answered_s <= within_s else None

    def note(self, message: Any, result: int, now_s: float) -> None:
        """Remember an answer."""
        self._answers.pop(_key(message), None)
        self._answers[_key(message)] = now_s, result
        while len(self._answers) > _MOST:
            del self._answers[next(iter(self._answers))]


def _key(message: Any) -> tuple[Any, ...]:
    # A NaN differs from itself; its text does not.
    numbers = repr([getattr(message, f"param{number}") for number in range(1, 5)])
    return message.get_srcSystem(), message.get_srcComponent(), message.command, numbers
