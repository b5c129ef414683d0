"""Records a run of `follower track`, so that it can be inspected and replayed like a flight."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from follower.recorded import recorded_settings
from follower.recorder import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder, epoch_now_ns
from follower.settings import Settings
from follower.track_options import TrackOptions
from follower_vision.clock import Clock


@contextmanager
def track_recorder(
    options: TrackOptions, settings: Settings, folder: Path, clock: Clock
) -> Iterator[Recorder | None]:
    """Give the recorder of a run into its folder, None if it is not to be recorded.

    Of several targets the first one is recorded: the one that setpoints are made for.

    Raises:
        OSError: the files cannot be made.
    """
    if not options.record:
        yield None
        return
    live = options.in_real_time
    config = FlightConfig.of(
        "video",
        recorded_settings(settings),
        run={"source": options.source, "targets": options.count, "detection": _how(options)},
        needs_telemetry=False,
        epoch_ns=epoch_now_ns(clock) if live else LOCKSTEP_EPOCH_NS,
    )
    with Recorder(folder, config, clock, settings.recorder, threaded=live) as recorder:
        yield recorder


def _how(options: TrackOptions) -> str:
    """Say how detection is run; in the background and shared it has its own time."""
    if options.in_real_time:
        return "background"
    return "shared" if options.count > 1 else "inline"
