"""Settings of the recorder."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar


class VideoKind(StrEnum):
    """How the frames that vision saw are kept."""

    H264 = "h264"
    """Small; what is decoded from it is close to what vision saw, but not the same."""
    LOSSLESS = "lossless"
    """Bit for bit what vision saw; some ten times as large."""
    NONE = "none"
    """No video."""


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """What is recorded of the frames, and how much memory and disk it may take.

    Attributes:
        video: "h264", "lossless" or "none".
        quality: of H.264, x264's constant rate factor: 0 (best) to 51 (worst).
        buffer_mb: frames that wait for the disk take at most this much memory; a frame for which
            there is no room is left out of the video.
        keep_free_mb: the video ends when the disk has less room than this, so that the log of the
            rest of the flight still fits.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    video: VideoKind = VideoKind.H264
    quality: int = 23
    buffer_mb: float = 96.0
    keep_free_mb: float = 200.0

    def __post_init__(self) -> None:
        if not 0 <= self.quality <= 51:
            raise ValueError(f"recorder: quality is 0 (best) to 51, not {self.quality}")
        if not 1 <= self.buffer_mb <= 100_000:
            raise ValueError(f"recorder: buffer_mb lies between 1 and 100000, not {self.buffer_mb}")
        if not 0 <= self.keep_free_mb < 1e9:
            raise ValueError(f"recorder: keep_free_mb is not negative, not {self.keep_free_mb}")
