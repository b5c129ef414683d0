"""Lost packets, counted by the gaps in their sender's numbers."""

from __future__ import annotations

_MODULUS = 256
_BACK = 128
"""A number that is less behind than ahead is a late packet, not a gap of half the numbers."""


class SequenceCounter:
    """Counts what one sender sent and we never got.

    Attributes:
        lost: packets that are missing.
    """

    def __init__(self) -> None:
        self._newest: int | None = None
        self.lost = 0

    def count(self, sequence: int) -> None:
        """Take the number of a packet that came."""
        newest = self._newest
        if newest is None:
            self._newest = sequence
            return
        ahead = (sequence - newest) % _MODULUS
        if ahead == 0:
            return
        if ahead >= _MODULUS - _BACK:
            self.lost = max(0, self.lost - 1)
            return
        self.lost += ahead - 1
        self._newest = sequence
