"""Settings of the recorder."""

from dataclasses import dataclass
from enum import StrEnum

from follower_control.common.strict_config import StrictFields, check_ranges


class VideoKind(StrEnum):
    """How the frames that vision saw are kept."""

    H264 = "h264"
    """Small; what is decoded from it is close to what vision saw, but not the same."""
    LOSSLESS = "lossless"
    """Bit for bit what vision saw; some ten times as large."""
    NONE = "none"
    """No video."""


class WhenFull(StrEnum):
    """What becomes of a flight when the disk has no room for its recording."""

    GO_ON = "go_on"
    """It goes on, unrecorded."""
    STOP = "stop"
    """It holds and releases the vehicle."""


@dataclass(frozen=True, slots=True)
class RecorderSettings(StrictFields):
    """What is recorded of the frames, and how much memory and disk it may take.

    Attributes:
        video: "h264", "lossless" or "none".
        quality: of H.264, x264's constant rate factor: 0 (best) to 51 (worst).
        buffer_mb: frames that wait for the disk take at most this much memory; a frame for which
            there is no room is left out of the video.
        keep_free_mb: the video ends when the disk has less room than this, so that the log of the
            rest of the flight still fits; so does the overlay of `follower track`, for its boxes.
        when_full: "go_on" or "stop": the flight, when video or log find no room.
        flight_min: for how many minutes of flight preflight wants room.
    """

    video: VideoKind = VideoKind.H264
    quality: int = 23
    buffer_mb: float = 96.0
    keep_free_mb: float = 200.0
    when_full: WhenFull = WhenFull.GO_ON
    flight_min: float = 30.0

    def __post_init__(self) -> None:
        check_ranges(self, quality=(0, 51), buffer_mb=(1, 100_000), keep_free_mb=(0, 1e9))
        check_ranges(self, flight_min=(1, 100_000))
