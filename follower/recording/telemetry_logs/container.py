"""Telemetry that is in the video file itself, as packets of a data stream."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import av
import av.container
import av.error
import av.packet

from follower.recording.telemetry_logs.gpmf import GpmfReader
from follower.recording.telemetry_logs.klv import KlvReader
from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.video_file import VideoFile, next_packet

_READERS = (KlvReader, GpmfReader)
_TRIED = 64


def has_telemetry(path: Path) -> bool:
    """Whether a file is a video with MISB ST 0601 or GPMF beside it, by its first packets."""
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            return any(_reader_of(data) for data, _, _ in islice(_packets(container), _TRIED))
    except (av.error.FFmpegError, OSError):
        return False


def read_container(path: Path) -> TelemetrySamples:
    """Read what is in a video file: MISB ST 0601 (in MPEG-TS) or GPMF (of GoPro, in MP4).

    A file that is cut off is read up to there. Times are the video's.

    Raises:
        TelemetryError: there is neither in it, or nothing of it is whole.
    """
    reader: KlvReader | GpmfReader | None = None
    start_s = _first_shown_s(path)
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            for data, shown_s, duration_s in _packets(container):
                reader = reader or _reader_of(data)
                if reader is not None:
                    reader.take(data, shown_s - start_s, duration_s)
    except av.error.FFmpegError as error:
        raise TelemetryError(f"{path}: no video that FFmpeg can open ({error.strerror})") from error
    if reader is None:
        raise TelemetryError(f"{path}: neither MISB ST 0601 nor GoPro's GPMF is in this file")
    try:
        return reader.samples()
    except TelemetryError as error:
        raise TelemetryError(f"{path}: {error}") from error


def _first_shown_s(path: Path) -> float:
    """Return when in the file the first frame is that can be shown, 0 where none can."""
    try:
        with VideoFile(path) as video:
            return video.origin_s
    except SourceError:
        return 0.0


def _reader_of(data: bytes) -> KlvReader | GpmfReader | None:
    return next((kind() for kind in _READERS if kind.knows(data)), None)


def _packets(container: av.container.InputContainer) -> Iterator[tuple[bytes, float, float]]:
    """Yield data packets with their time in the file and their duration, in seconds.

    A time that the file does not tell is NaN. A damaged end is an end.
    """
    if not container.streams.data:
        return
    packets = container.demux(container.streams.data)
    while True:
        try:
            packet = next_packet(packets)
        except av.error.FFmpegError:
            return
        if packet is None:
            return
        if packet.size:
            base = packet.time_base or 0
            shown_s = math.nan if packet.pts is None else float(packet.pts * base)
            yield bytes(packet), shown_s, float((packet.duration or 0) * base) or 1.0
