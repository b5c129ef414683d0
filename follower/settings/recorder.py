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


@dataclass(frozen=True, slots=True)
class RecorderSettings(StrictFields):
    """What is recorded of the frames, and how much memory and disk it may take.

    Attributes:
        video: "h264", "lossless" or "none".
        quality: of H.264, x264's constant rate factor: 0 (best) to 51 (worst).
        buffer_mb: frames that wait for the disk take at most this much memory; a frame for which
            there is no room is left out of the video.
        keep_free_mb: the video ends when the disk has less room than this, so that the log of the
            rest of the flight still fits.
    """

    video: VideoKind = VideoKind.H264
    quality: int = 23
    buffer_mb: float = 96.0
    keep_free_mb: float = 200.0

    def __post_init__(self) -> None:
        check_ranges(self, quality=(0, 51), buffer_mb=(1, 100_000), keep_free_mb=(0, 1e9))
