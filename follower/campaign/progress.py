"""How far a campaign is, and how long it will still take."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from follower.print_line import print_line
from follower_vision.clock import Clock, MonotonicClock

_FEWEST = 3
_PLAIN_S = 20.0


class CampaignProgress:
    """A bar on a terminal, else a line now and then.

    The time to go is what is left at the pace since this start; what was flown before it does not
    count, and nothing is said before a few runs of this start are finished.

    Args:
        console: where to.
        title: what is flown.
        total: how many runs there are.
        before: how many of them were finished before.
        clock: the reader's time.
    """

    def __init__(
        self, console: Console, title: str, total: int, before: int, clock: Clock | None = None
    ) -> None:
        self._console = console
        self._clock = clock or MonotonicClock()
        self._total, self._before, self._done = total, before, before
        self._begun_s = self._shown_s = self._clock.now()
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task(title, total=total, completed=before, left="")

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def finished(self) -> None:
        """Count one more run."""
        self._done += 1
        left = self.left()
        if self._console.is_terminal:
            self._bar.update(self._task, completed=self._done, left=left)
        elif self._clock.now() - self._shown_s > _PLAIN_S:
            self._shown_s = self._clock.now()
            print_line(self._console, f"{self._done} of {self._total} runs, {left}")

    def left(self) -> str:
        """Return the time to go in words."""
        if self._done >= self._total:
            return "done"
        flown = self._done - self._before
        if flown < _FEWEST:
            return "time to go not known yet"
        pace_s = (self._clock.now() - self._begun_s) / flown
        return f"about {in_words(pace_s * (self._total - self._done))} to go"


def in_words(seconds: float) -> str:
    """Return a time as one would say it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
