"""Opens whatever a user names as a source of frames."""

from __future__ import annotations

from pathlib import Path

from follower_vision.framesource import FrameSource, SourceError
from follower_vision.imagefolder import ImageFolder
from follower_vision.paced import Paced
from follower_vision.videofile import VideoFile

__all__ = ["FrameSource", "ImageFolder", "Paced", "SourceError", "VideoFile", "open_source"]


def open_source(spec: str, *, folder_rate_hz: float = 30.0) -> FrameSource:
    """Open a source of frames.

    Args:
        spec: a video file or a folder of images.
        folder_rate_hz: frames a second of a folder of images.

    Raises:
        SourceError: nothing can be read there; the message says why and what to do.
    """
    path = Path(spec).expanduser()
    if path.is_dir():
        return ImageFolder(path, folder_rate_hz)
    return VideoFile(path)
