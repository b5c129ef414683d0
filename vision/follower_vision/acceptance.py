"""How well a found candidate has to score to be taken for the target."""

from __future__ import annotations

from follower_vision.longterm_settings import LongTermSettings

_STRIKE = 0.05
_FORGIVEN_PER_S = 1.0


class Acceptance:
    """The paper's epsilon, raised where it would be reached by chance.

    Among things that look like the target more is asked; and after each candidate that passed but
    did not prove true, because who draws often enough draws a wrong one that fits.
    """

    def __init__(self, settings: LongTermSettings) -> None:
        self._settings = settings
        self._strikes = 0.0
        self._struck_s = 0.0

    def reset(self) -> None:
        """Forget the failures: the target was found, or another one was chosen."""
        self._strikes = 0.0

    def fail(self, now_s: float) -> None:
        """A candidate that had passed was not the target after all."""
        self._strikes = self._left(now_s) + 1
        self._struck_s = now_s

    def epsilon(self, surroundings: float | None, now_s: float) -> float:
        """Return the least score, 0 to 2.

        Args:
            surroundings: the highest score of the target's surroundings; None if unknown.
            now_s: the frame's time in seconds.
        """
        settings = self._settings
        paper = settings.reidentify.epsilon
        among = (surroundings or 0.0) + settings.look_alike_margin
        asked = max(paper, among) + _STRIKE * self._left(now_s)
        return max(paper, min(asked, settings.most_epsilon))

    def _left(self, now_s: float) -> float:
        """The strikes that time has not forgiven yet."""
        return max(0.0, self._strikes - _FORGIVEN_PER_S * (now_s - self._struck_s))
