"""What a person wants to see of a track while it goes on."""

from __future__ import annotations

from dataclasses import dataclass

from follower.track_run import TrackRun
from follower_vision.live import LiveSource
from follower_vision.paced import Paced
from follower_vision.track import Track


@dataclass(frozen=True, slots=True)
class TrackStatus:
    """One moment of a run.

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
        """Return the present moment of a run that goes on on another thread."""
        source, records = run.source, run.logs[0].tracks
        live = isinstance(source, LiveSource)
        by_clock = isinstance(source, LiveSource | Paced)
        # The last target's log is the last to grow.
        frames = len(run.logs[-1].tracks)
        newest = [log.tracks[frames - 1] for log in run.logs] if frames else []
        return cls(
            frames=frames,
            total=source.frame_count,
            time_s=newest[0].captured_s - records[0].captured_s if newest else 0.0,
            tracks=tuple(record.track for record in newest if record.track is not None),
            delay_s=newest[0].done_s - newest[0].captured_s if newest and by_clock else None,
            skipped=source.skipped if isinstance(source, LiveSource | Paced) else 0,
            reconnects=max(0, source.connections - 1) if isinstance(source, LiveSource) else 0,
            problem=source.problem if live else None,
        )


def status_line(status: TrackStatus, waiting_for: str, rate_hz: float | None) -> str:
    """Return a status in one line.

    Args:
        status: what to tell.
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


def counted(number: int, thing: str) -> str:
    """Return a number of things: "1 frame", "2 frames"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _targets(tracks: tuple[Track, ...]) -> str:
    if len(tracks) == 1:
        return f"{tracks[0].state:<8} {tracks[0].confidence:4.2f}"
    numbered = enumerate(tracks, 1)
    return "  ".join(
        f"{number} {track.state} {track.confidence:4.2f}" for number, track in numbered
    )
