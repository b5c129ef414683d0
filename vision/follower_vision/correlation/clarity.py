"""How clear a response's peak is, beside what is usual for this target."""

from __future__ import annotations

_NOISE = 4.0
_LEAST_USUAL = 8.0
_MEMORY = 20


class Clarity:
    """Judges peak to sidelobe ratios by the average of those that were trusted.

    How high the ratio of a well-followed target is depends on the target: 7 for one that changes
    its looks, 17 for a stiff one. A sudden drop tells of occlusion or loss in both.

    Args:
        doubtful_share: at this share of the usual ratio and below, nothing is to be learnt.
        full_share: at this share and above, everything is.
    """

    def __init__(self, doubtful_share: float, full_share: float) -> None:
        self._doubtful = doubtful_share
        self._full = full_share
        self._usual = _LEAST_USUAL
        self._count = 0

    def trust(self, ratio: float) -> float:
        """Return how much of the present image to learn, 0 to 1."""
        if not self._count:
            return 1.0
        return _ramp(ratio / self._usual, self._doubtful, self._full)

    def confidence(self, ratio: float) -> float:
        """Return 0 where the ratio is that of noise, 1 where it is the usual one or more."""
        return _ramp(ratio, _NOISE, max(self._usual, _LEAST_USUAL))

    def remember(self, ratio: float, trust: float) -> None:
        """Take a ratio into the average; the first ones count as much as all before them."""
        if trust <= 0:
            return
        self._count += 1
        self._usual += trust * (ratio - self._usual) / min(self._count, _MEMORY)


def _ramp(value: float, low: float, high: float) -> float:
    return min(1.0, max(0.0, (value - low) / (high - low)))
