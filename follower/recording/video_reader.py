"""Reads `video.mkv`: pictures with the numbers and times that the log gives them."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import av
import av.error

from follower.recording.mcap_writer import FlightFileError
from follower.recording.messages import FrameRecord
from follower.recording.video_writer import TICK, FrameTimes, to_image
from follower_vision.images.frame import Frame
from follower_vision.sources.video_file import next_packet

ResultT = TypeVar("ResultT")

_FAILURES = (av.error.FFmpegError, OSError)


def read_pictures(path: Path, frames: Sequence[FrameRecord], remarks: list[str]) -> Iterator[Frame]:
    """Return the frames that the video holds, decoded one by one.

    A picture says by its time which frame it is. After one that is missing or damaged none is
    right before the next key frame, for each is stored as what changed since the one before.

    Args:
        path: the video.
        frames: the log's record of the frames.
        remarks: gets a sentence, once, if pictures are missing.

    Raises:
        FlightFileError: there is no video, or it cannot be opened.
    """
    expected = _by_tick(frames)
    due = found = 0
    whole = True
    for picture in _decoded(path):
        number, record = expected.get(_tick(picture), (-1, None))
        if record is None or number < due:
            continue
        whole = (picture.key_frame or (whole and number == due)) and not picture.is_corrupt
        due = number + 1
        if whole:
            found += 1
            image = to_image(picture, record.width, record.height)
            yield Frame(image, record.captured_s, record.sequence)
    if found < len(expected):
        missing = f"misses {len(expected) - found} of its"
        ends = f"ends after {found} of" if found == due else missing
        said = f"{path.name} {ends} {len(expected)} pictures."
        remarks += [] if said in remarks else [said]


class FrameFinder:
    """Gives the picture of one frame after another.

    Args:
        pictures: in the frames' order, with none of some.
    """

    def __init__(self, pictures: Iterator[Frame]) -> None:
        self._pictures = pictures
        self._next: Frame | None = None

    def of(self, record: FrameRecord) -> Frame | None:
        """Return a later frame than last time; None if the video does not hold it."""
        if record.video_index is None:
            return None
        if self._next is None:
            self._next = next(self._pictures, None)
        if self._next is None or self._next.sequence != record.sequence:
            return None
        found, self._next = self._next, None
        return found


def video_problem(path: Path) -> str | None:
    """Return why a video cannot be read at all, in a few words; None if it can."""
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            return None if container.streams.video else "no video is in it"
    except _FAILURES as error:
        return "it is missing" if not path.exists() else error.strerror or str(error)


def _by_tick(frames: Sequence[FrameRecord]) -> dict[int, tuple[int, FrameRecord]]:
    """Return which picture and frame should stand where in the video."""
    times = FrameTimes()
    inside = [frame for frame in frames if frame.video_index is not None]
    return {times.of(one.captured_s): (number, one) for number, one in enumerate(inside)}


def _tick(picture: av.VideoFrame) -> int:
    if picture.pts is None or picture.time_base is None:
        return -1
    return round(picture.pts * picture.time_base / TICK)


def _decoded(path: Path) -> Iterator[av.VideoFrame]:
    """Give the pictures; what is damaged is passed over."""
    if not path.is_file():
        raise FlightFileError(f"{path}: the flight has no video; its log can be read")
    try:
        container = av.open(str(path), metadata_errors="replace")
        stream = container.streams.video[0]
    except (*_FAILURES, IndexError) as error:
        raise FlightFileError(f"{path}: the video cannot be read ({error})") from error
    with container:
        packets = container.demux(stream)
        while (packet := _tried(partial(next_packet, packets))) is not None:
            yield from _tried(packet.decode) or ()


def _tried(read: Callable[[], ResultT | None]) -> ResultT | None:
    try:
        return read()
    except _FAILURES:
        return None
