"""The terminal line of `follower track`."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from rich.console import Console, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from follower.apps.track.run import TrackRun
from follower.ui.terminal.console import counted
from follower.ui.terminal.flight_display import LiveDisplay
from follower_vision.sources.frame_source import RealtimePlayback
from follower_vision.sources.live_source import LiveSource
from follower_vision.trackers.track import Track


@dataclass(frozen=True, slots=True)
class TrackStatus:
    """How far a run has come.

    Attributes:
        frames: answered for so far.
        total: how many there will be, None if nobody knows.
        time_s: capture time of the newest, from the first.
        tracks: the newest of each target; none while they are being looked for.
        delay_s: from capture to answer; None if frames do not come by the clock.
        skipped: frames that came too fast to be looked at.
        reconnects: how often a live source was lost and found again.
        problem: what keeps frames from coming.
    """

    frames: int = 0
    total: int | None = None
    time_s: float = 0.0
    tracks: tuple[Track, ...] = ()
    delay_s: float | None = None
    skipped: int = 0
    reconnects: int = 0
    problem: str | None = None

    @classmethod
    def of(cls, run: TrackRun) -> TrackStatus:
        """Return the status of a run on another thread."""
        source, records = run.source, run.logs[0].tracks
        by_clock = isinstance(source, LiveSource | RealtimePlayback)
        # The last target's log is the last to grow.
        frames = len(run.logs[-1].tracks)
        newest = [log.tracks[frames - 1] for log in run.logs] if frames else []
        return cls(
            frames=frames,
            total=source.frame_count,
            time_s=newest[0].captured_s - records[0].captured_s if newest else 0.0,
            tracks=tuple(record.track for record in newest if record.track is not None),
            delay_s=newest[0].done_s - newest[0].captured_s if newest and by_clock else None,
            skipped=source.skipped if isinstance(source, LiveSource | RealtimePlayback) else 0,
            reconnects=max(0, source.connections - 1) if isinstance(source, LiveSource) else 0,
            problem=source.problem if isinstance(source, LiveSource) else None,
        )


def status_line(status: TrackStatus, waiting_for: str, rate_hz: float | None) -> str:
    """Return a status in one line.

    Args:
        status: what to show.
        waiting_for: what is looked for while there is no track.
        rate_hz: frames answered for in a second, None while nobody knows.
    """
    if status.problem is not None:
        parts = [f"no frames: {status.problem}"]
    else:
        parts = [_targets(status.tracks) or f"waiting for {waiting_for}"]
        if rate_hz is not None:
            parts.append(f"{rate_hz:.0f} frames/s")
        if status.delay_s is not None:
            parts.append(f"delay {1e3 * status.delay_s:.0f} ms")
    if status.delay_s is not None:
        parts.append(f"{status.skipped} dropped")
    if status.reconnects:
        parts.append(counted(status.reconnects, "reconnect"))
    return "  ".join(parts)


def _targets(tracks: tuple[Track, ...]) -> str:
    if len(tracks) == 1:
        return f"{tracks[0].state:<8} {tracks[0].confidence:4.2f}"
    return "  ".join(f"{n} {one.state} {one.confidence:4.2f}" for n, one in enumerate(tracks, 1))


_PLAIN_S = 5.0
_RATE_OVER_S = 1.0
_BAR_WIDTH = 30


class TrackDisplay(LiveDisplay):
    """Shows a run while it goes on: one line, with a bar where the number of frames is known.

    On a terminal the line is redrawn at each `show`; into a file or pipe a line is written every
    five seconds, and when the source breaks or comes back.

    Args:
        console: where to.
        waiting_for: what is looked for while there is no track.
    """

    def __init__(self, console: Console, waiting_for: str) -> None:
        super().__init__(console)
        self._waiting_for = waiting_for
        self._counts: deque[tuple[float, int]] = deque()
        self._shown_about: tuple[str | None, bool] = (None, False)

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

    def _rate_hz(self, now_s: float, frames: int) -> float | None:
        """Return the frames a second of about the last second."""
        self._counts.append((now_s, frames))
        while len(self._counts) > 2 and self._counts[1][0] <= now_s - _RATE_OVER_S:
            self._counts.popleft()
        before_s, before = self._counts[0]
        return (frames - before) / (now_s - before_s) if now_s - before_s > 0.5 else None


def _row(status: TrackStatus, line: str) -> RenderableType:
    cells: list[RenderableType] = [_progress(status)]
    if status.total is not None:
        bar = ProgressBar(status.total, status.frames + status.skipped, width=_BAR_WIDTH)
        cells.insert(0, bar)
    row = Table.grid(padding=(0, 2))
    row.add_row(*cells, Text(line, overflow="ellipsis", no_wrap=True))
    return row


def _progress(status: TrackStatus) -> str:
    if status.total is None:
        return f"{status.time_s:6.1f} s"
    return f"{status.frames}/{status.total}"
