"""The terminal line of `follower track`."""

from __future__ import annotations

import math
from collections import deque
from types import TracebackType
from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from follower.print_line import print_line
from follower.track_status import TrackStatus, status_line
from follower_vision.clock import Clock, MonotonicClock

_PLAIN_S = 5.0
_RATE_OVER_S = 1.0
_BAR_WIDTH = 30


class TrackDisplay:
    """Shows a run while it goes on: one line, with a bar where the number of frames is known.

    On a terminal the line is redrawn at each `show`; into a file or pipe a line is written every
    five seconds, and when the source breaks or comes back.

    Args:
        console: where to.
        waiting_for: what is looked for while there is no track.
        clock: the reader's time, not the frames'.
    """

    def __init__(self, console: Console, waiting_for: str, clock: Clock | None = None) -> None:
        self._console = console
        self._waiting_for = waiting_for
        self._clock = clock or MonotonicClock()
        self._live: Live | None = None
        self._counts: deque[tuple[float, int]] = deque()
        self._shown_s = -math.inf
        self._shown_about: tuple[str | None, bool] = (None, False)

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def show(self, status: TrackStatus) -> None:
        """Show a status; into a file only if it is time to."""
        now_s = self._clock.now()
        line = status_line(status, self._waiting_for, self._rate_hz(now_s, status.frames))
        if self._live is not None:
            self._live.update(_row(status, line), refresh=True)
            return
        about = status.problem, bool(status.tracks)
        if now_s - self._shown_s >= _PLAIN_S or about != self._shown_about:
            self._shown_s, self._shown_about = now_s, about
            self.say(f"{_progress(status)}  {line}")

    def say(self, text: str) -> None:
        """Write a line that stays."""
        print_line(self._console, text)

    def _rate_hz(self, now_s: float, frames: int) -> float | None:
        """Return the frames a second of about the last second."""
        self._counts.append((now_s, frames))
        while len(self._counts) > 2 and self._counts[1][0] <= now_s - _RATE_OVER_S:
            self._counts.popleft()
        before_s, before = self._counts[0]
        return (frames - before) / (now_s - before_s) if now_s - before_s > 0.5 else None


def _row(status: TrackStatus, line: str) -> RenderableType:
    row = Table.grid(padding=(0, 2))
    row.add_column(no_wrap=True)
    row.add_column(no_wrap=True, overflow="ellipsis")
    text = Text(line, overflow="ellipsis", no_wrap=True)
    if status.total is None:
        row.add_row(_progress(status), text)
        return row
    row.add_column(no_wrap=True, overflow="ellipsis")
    bar = ProgressBar(status.total, status.frames + status.skipped, width=_BAR_WIDTH)
    row.add_row(bar, _progress(status), text)
    return row


def _progress(status: TrackStatus) -> str:
    if status.total is None:
        return f"{status.time_s:6.1f} s"
    return f"{status.frames}/{status.total}"
