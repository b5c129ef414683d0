"""What `follower import` is given: videos, telemetry and bags, told apart by what is in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from follower.apps.video_input import VideoInput, is_bag
from follower.recording.telemetry_logs import (
    TelemetryLog,
    is_telemetry_log,
    read_telemetry,
    telemetry_of_video,
)
from follower.ui.terminal.console import check_extra
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import Clock
from follower_vision.sources.frame_source import FrameSource
from follower_vision.sources.open import local_path


@dataclass(frozen=True, slots=True)
class BagInput(VideoInput):
    """A rosbag2's folder, or ROS 1's .bag."""

    def open(self, clock: Clock | None = None) -> FrameSource:
        """Open its images; a bag is never live, so the clock does not count.

        Raises:
            SettingsError: rosbags is not installed.
            SourceError: it has no images, or cannot be read.
        """
        del clock
        check_extra("a bag", "ros", "rosbags")
        from follower.apps.ros.bag import BagImages

        return BagImages(local_path(self.name))

    def telemetry(self) -> TelemetryLog | None:
        """Return what it tells of the vehicle, None if nothing; raises what `open` does."""
        check_extra("a bag", "ros", "rosbags")
        from follower.apps.ros.bag import read_bag

        return read_bag(local_path(self.name))


def sort_inputs(
    files: Sequence[str], telemetry: Path | None, rate_hz: float
) -> tuple[VideoInput | None, Path | None]:
    """Tell the video and the telemetry log apart; either may be missing.

    Args:
        files: as they were named, in any order.
        telemetry: a log that was named as such.
        rate_hz: of a folder of images.

    Raises:
        SettingsError: there are two of a kind.
        SourceError: a name begins with that of no user.
    """
    videos, logs = list[str](), [] if telemetry is None else [telemetry]
    for name in files:
        path = local_path(name)
        if path.is_file() and is_telemetry_log(path) and not is_bag(path):
            logs.append(path)
        else:
            videos.append(name)
    for kind, found in (("videos", videos), ("telemetry logs", logs)):
        if len(found) > 1:
            raise SettingsError(f"{found[0]} and {found[1]} are two {kind}: import one at a time")
    if not videos:
        return None, logs[0]
    source = BagInput if is_bag(local_path(videos[0])) else VideoInput
    return source(videos[0], rate_hz=rate_hz), logs[0] if logs else None


def telemetry_of(
    source: VideoInput | None, telemetry: Path | None
) -> tuple[TelemetryLog | None, str]:
    """Read the telemetry that was named, or the video's own; return it with its name.

    Raises:
        SourceError: it cannot be used.
    """
    if telemetry is None and isinstance(source, BagInput):
        return source.telemetry(), source.name
    if telemetry is None and source is not None:
        telemetry = telemetry_of_video(local_path(source.name))
    return (None, "") if telemetry is None else (read_telemetry(telemetry), str(telemetry))
