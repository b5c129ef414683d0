"""Fits a box that is roughly right."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from follower_vision.box import Box

_STEPS = (0.2, 0.1)
_ROUNDS = 2


def refined(box: Box, score: Callable[[Box], float]) -> tuple[Box, float]:
    """Return a better box near the given one, and its score, by trying sizes and shifts.

    A bounded climb: at most 25 calls of `score`.
    """
    best, best_score = box, score(box)
    for step in _STEPS:
        for _ in range(_ROUNDS):
            tried = [(candidate, score(candidate)) for candidate in _neighbours(best, step)]
            winner, winner_score = max(tried, key=lambda pair: pair[1])
            if winner_score <= best_score:
                break
            best, best_score = winner, winner_score
    return best, best_score


def _neighbours(box: Box, step: float) -> Iterator[Box]:
    yield box.scaled(1 + step)
    yield box.scaled(1 / (1 + step))
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        yield box.moved_to(
            box.cx + right * step * box.width / 2, box.cy + down * step * box.height / 2
        )
