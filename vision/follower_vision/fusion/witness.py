"""What it means that the detector does not see the target where the motion tracker has it."""

from __future__ import annotations

_HIT_MEMORY_LOOKS = 6
_MISS_MEMORY_LOOKS = 20
_FIRST_RECALL = 0.5
_MOST_RECALL = 0.9
_ODD_CHANCE = 0.25
_CHANCE = 0.1
_SLIGHT_CHANCE = 0.02


class Witness:
    """Learns how often the detector sees the target, and so what it is worth if it does not.

    A detector that sees a target in nine looks of ten and then twice in a row does not speaks
    against the track; one that sees it in every third look does not.
    """

    def __init__(self) -> None:
        self._recall = _FIRST_RECALL
        self._absent = 0

    def testify(self, seen: bool, trusted: bool) -> None:
        """Take a look.

        Args:
            seen: whether something of the target's kind is where the motion tracker has it.
            trusted: whether the tracker is believed: then the detector's own rate is learnt.
        """
        self._absent = 0 if seen else self._absent + 1
        if trusted and seen:
            self._recall += (1.0 - self._recall) / _HIT_MEMORY_LOOKS
        elif trusted:
            self._recall -= self._recall / _MISS_MEMORY_LOOKS

    def overrule(self) -> None:
        """Believe the motion tracker all the same: the detector may no longer know the target."""
        self._recall = min(self._recall, _FIRST_RECALL)
        self._absent = 0

    @property
    def wonders(self) -> bool:
        """Whether it is odd (25 %) that the last looks showed nothing there."""
        return self._miss_chance() < _ODD_CHANCE

    @property
    def objects(self) -> bool:
        """Whether it is unlikely (10 %) that the target is there all the same."""
        return self._miss_chance() < _CHANCE

    @property
    def denies(self) -> bool:
        """Whether that is very unlikely (2 %)."""
        return self._miss_chance() < _SLIGHT_CHANCE

    def _miss_chance(self) -> float:
        """How likely so many misses in a row are if the target is there."""
        return float((1.0 - min(self._recall, _MOST_RECALL)) ** self._absent)
