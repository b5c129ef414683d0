"""Reads `video.mkv`: pictures with the numbers and times that the log gives them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import av
import av.error

from follower.recorder.pictures import to_image
from follower.recorder.reading import FlightFileError
from follower.recorder.records import FrameRecord
from follower_vision.frame import Frame

_FAILURES = (av.error.FFmpegError, OSError)


def read_pictures(path: Path, frames: Sequence[FrameRecord], remarks: list[str]) -> Iterator[Frame]:
    """Return the frames that the video holds, decoded one by one.

    Args:
        path: the video.
        frames: the log's record of the frames.
        remarks: gets a sentence if pictures are missing.

    Raises:
        FlightFileError: there is no video, or it cannot be opened.
    """
    wanted = {frame.video_index: frame for frame in frames if frame.video_index is not None}
    found = 0
    for index, picture in enumerate(_decoded(path)):
        record = wanted.get(index)
        if record is not None:
            found += 1
            image = to_image(picture, record.width, record.height)
            yield Frame(image, record.captured_s, record.sequence)
    if found < len(wanted):
        remarks.append(f"{path.name} ends after {found} of {len(wanted)} pictures.")


def _decoded(path: Path) -> Iterator[av.VideoFrame]:
    """Give the pictures, up to where the file is cut off."""
    if not path.is_file():
        raise FlightFileError(f"{path}: the flight has no video; its log can be read")
    try:
        container = av.open(str(path))
        stream = container.streams.video[0]
    except (*_FAILURES, IndexError) as error:
        raise FlightFileError(f"{path}: the video cannot be read ({error})") from error
    with container:
        try:
            yield from container.decode(stream)
        except _FAILURES:
            return
