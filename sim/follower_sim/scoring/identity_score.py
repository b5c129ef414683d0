"""How soon a hidden target is found again, and whether another one is taken for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

from follower_sim.kinematics import TruthSample

HIDDEN, PLAIN = 0.05, 0.5
"""A target is hidden while less than the first share of it is to be seen, until the second is."""

LEAST_HIDDEN_S = 0.5
"""Shorter absences do not count."""

FOUND_IOU = 0.2
"""A track is on the target if its box overlaps the true one so much."""

MISTAKEN_IOU = 0.3
"""A track is on another target if it overlaps that one so much, and the true one hardly: 0.1."""

_HARDLY = 0.1
_SAME_RUN_S = 0.25
TAKEN_S, SEEN_AGAIN_S = 0.3, 1.0
"""For so long another target has to be tracked, or the target to be in the open, to count."""


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """A frame in which vision said that it sees the target.

    Attributes:
        time_s: when it was truly taken, on the truth's clock.
        overlap: of the track's box with the true one, intersection over union.
        other: the largest with another target's.
    """

    time_s: float
    overlap: float
    other: float


@dataclass(frozen=True, slots=True)
class IdentityScore:
    """What became of the target's identity.

    Attributes:
        disappearances: how often the target was hidden for at least half a second.
        longest_hidden_s: the longest of these times.
        never_found: after how many of them it was not found again.
        slowest_found_s: the longest time from when half of it was to be seen again to the first
            tracked frame on it; None if it was never hidden, or never found again.
        mistaken_s: the longest time for which another target was tracked; None if there is none.
    """

    disappearances: int = 0
    longest_hidden_s: float = 0.0
    never_found: int = 0
    slowest_found_s: float | None = None
    mistaken_s: float | None = None


def identity_score(
    truth: Sequence[TruthSample],
    tracked: Sequence[TrackedFrame],
    others: bool,
) -> IdentityScore:
    """Compare what was tracked with the truth.

    Args:
        truth: samples in the order of time.
        tracked: the frames said to be tracked, in the order of time.
        others: whether there are other targets.
    """
    right = [frame.time_s for frame in tracked if frame.overlap >= FOUND_IOU]
    absences = _absences(truth, right[0]) if right else []
    waits = [_wait(back_s, right) for _, back_s in absences]
    found = [wait for wait in waits if wait is not None]
    return IdentityScore(
        len(absences),
        max((back_s - gone_s for gone_s, back_s in absences), default=0.0),
        len(waits) - len(found),
        max(found, default=None),
        _longest_mistake(tracked) if others else None,
    )


def _absences(truth: Sequence[TruthSample], from_s: float) -> list[tuple[float, float]]:
    """Return when the target vanished and when it was plainly to be seen again."""
    found: list[tuple[float, float]] = []
    gone_s: float | None = None
    for sample in truth:
        seen = min(sample.visible_share, sample.in_frame_share)
        if gone_s is None and seen < HIDDEN and sample.time_s >= from_s:
            gone_s = sample.time_s
        elif gone_s is not None and seen >= PLAIN:
            if sample.time_s - gone_s >= LEAST_HIDDEN_S:
                found.append((gone_s, sample.time_s))
            gone_s = None
    return found


def _wait(back_s: float, right: Sequence[float]) -> float | None:
    """Return how long it took from then on; nothing if it was found before it was plain."""
    after = next((time_s for time_s in right if time_s >= back_s), None)
    return None if after is None else after - back_s


def _longest_mistake(tracked: Sequence[TrackedFrame]) -> float:
    """Return the longest run of frames on another target."""
    return max((last_s - began_s for began_s, last_s in _mistakes(tracked)), default=0.0)


def _mistakes(tracked: Sequence[TrackedFrame]) -> list[tuple[float, float]]:
    """Return the first and the last time of each run of frames on another target."""
    runs: list[tuple[float, float]] = []
    goes_on = False
    for frame in tracked:
        if frame.other < MISTAKEN_IOU or frame.overlap >= _HARDLY:
            goes_on = False
            continue
        goes_on = goes_on and frame.time_s - runs[-1][1] <= _SAME_RUN_S
        runs.append((runs.pop()[0] if goes_on else frame.time_s, frame.time_s))
        goes_on = True
    return runs


class WrongEnd(StrEnum):
    """How a pursuit came to end without its target, though nothing hid that any more."""

    PLAIN_SWAP = "swap in plain sight"
    COVERED_SWAP = "swap under cover"
    LOST = "lost"
    """It went out of the track or out of the image while nothing hid it."""
    NOT_FOUND = "not found"
    """It was hidden, and not found again."""

    @property
    def is_swap(self) -> bool:
        """Whether another target was followed instead."""
        return self in (WrongEnd.PLAIN_SWAP, WrongEnd.COVERED_SWAP)


def wrong_end(
    truth: Sequence[TruthSample], tracked: Sequence[TrackedFrame], until_s: float
) -> WrongEnd | None:
    """Return how a pursuit ended wrongly.

    None if after the last tracked frame on the target it was never in the open for a second, nor
    another one tracked; and if the target never was tracked.

    Args:
        truth: samples in the order of time.
        tracked: the frames said to be tracked, in the order of time.
        until_s: the end of the pursuit.
    """
    tracked = [frame for frame in tracked if frame.time_s <= until_s]
    right_s = max((one.time_s for one in tracked if one.overlap >= FOUND_IOU), default=None)
    if right_s is None:
        return None
    after = [sample for sample in truth if right_s <= sample.time_s <= until_s]
    covered_s = [sample.time_s for sample in after if sample.visible_share < PLAIN]
    mistakes = _mistakes([frame for frame in tracked if frame.time_s > right_s])
    swap_s = next((began for began, last in mistakes if last - began >= TAKEN_S), None)
    left_s = right_s + LEAST_HIDDEN_S if swap_s is None else swap_s
    covered = any(time_s <= left_s for time_s in covered_s)
    if swap_s is not None:
        return WrongEnd.COVERED_SWAP if covered else WrongEnd.PLAIN_SWAP
    ends_s = [right_s, *covered_s, *(sample.time_s for sample in after[-1:])]
    if max((end - start for start, end in pairwise(ends_s)), default=0.0) < SEEN_AGAIN_S:
        return None
    return WrongEnd.NOT_FOUND if covered else WrongEnd.LOST
