"""When something hid the target, and how soon it was seen again; from the simulator's truth."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from follower_sim.kinematics import TruthSample

HIDDEN = 0.5
"""The target is hidden while less than this share of it is visible."""

SHORTEST_S, LONGEST_GAP_S = 0.1, 0.3
"""What is shorter is no occlusion; what lies closer together is one."""
_PATIENCE_S = 1.0


@dataclass(frozen=True, slots=True)
class Occlusion:
    """One time during which the target was hidden.

    Attributes:
        start_s: when it began.
        end_s: when it was over.
        reacquired_s: from its end until vision said again, rightly, to see the target; None if
            that never came, or not before the next occlusion.
    """

    start_s: float
    end_s: float
    reacquired_s: float | None

    @property
    def length_s(self) -> float:
        """How long it lasted, seconds."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class ObservedFrame:
    """A frame in which vision rightly said to see the target.

    Attributes:
        captured_s: when it was taken.
        known_s: when that was known to control.
    """

    captured_s: float
    known_s: float


def occlusions(
    truth: Sequence[TruthSample],
    observed: Sequence[ObservedFrame],
    from_s: float,
    until_s: float,
) -> list[Occlusion]:
    """Return the occlusions that began within a time and left a second of it to see again.

    Args:
        truth: samples in the order of time.
        observed: the frames with the target seen, in the order of time.
        from_s: what began earlier does not count.
        until_s: the end of the time that is looked at.
    """
    spans = hidden_spans(truth)
    nexts = [*(start for start, _ in spans[1:]), math.inf]
    return [
        Occlusion(start, end, _reacquired(observed, end, following))
        for (start, end), following in zip(spans, nexts, strict=False)
        if start >= from_s and end <= until_s - _PATIENCE_S
    ]


def hidden_spans(truth: Sequence[TruthSample]) -> list[tuple[float, float]]:
    """Return (start, end), seconds, of each time with the target hidden that is over."""
    spans: list[tuple[float, float]] = []
    start_s: float | None = None
    for sample in truth:
        hidden = sample.visible_share < HIDDEN
        if hidden and start_s is None:
            start_s = sample.time_s
        elif not hidden and start_s is not None:
            _join(spans, start_s, sample.time_s)
            start_s = None
    return [(start, end) for start, end in spans if end - start >= SHORTEST_S]


def _join(spans: list[tuple[float, float]], start_s: float, end_s: float) -> None:
    if spans and start_s - spans[-1][1] < LONGEST_GAP_S:
        start_s = spans.pop()[0]
    spans.append((start_s, end_s))


def _reacquired(observed: Sequence[ObservedFrame], end_s: float, before_s: float) -> float | None:
    found = next((one for one in observed if one.captured_s >= end_s), None)
    if found is None or found.captured_s >= before_s:
        return None
    return max(0.0, found.known_s - end_s)
