"""Reads `flight.mcap` from its beginning to its end, or to where it was cut off."""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Header, McapRecord, Metadata
from mcap.records import Message as McapMessage
from mcap.stream_reader import CRCValidationError, StreamReader

from follower.recorder.codec import decode
from follower.recorder.mcap_log import FORMAT, METADATA, PROFILE
from follower.recorder.messages import BY_TOPIC
from follower.recorder.records import StepRecord
from follower_vision.framesource import SourceError

_BROKEN = (
    McapError,
    CRCValidationError,
    OverflowError,
    UnicodeDecodeError,
    struct.error,
    zlib.error,
    zstandard.ZstdError,
)
_MOST_BYTES_A_RECORD = 1 << 30
_OTHER_FILES = "config.yaml, mavlink.tlog and video.mkv can be read by other programs"


class FlightFileError(SourceError):
    """A flight cannot be read; the message says which file, why, and what could be read."""


@dataclass(slots=True)
class LogContent:
    """What was in a log.

    Attributes:
        messages: (seconds on the flight's clock, dataclass of the table), in the order written.
        config_yaml: the configuration that the log carries, "" if it does not.
        remarks: what is missing or was passed over, in sentences.
    """

    messages: list[tuple[float, object]] = field(default_factory=list)
    config_yaml: str = ""
    remarks: list[str] = field(default_factory=list)


def read_log(path: Path) -> LogContent:
    """Read a log.

    Raises:
        FlightFileError: it is none, is foreign, is of a newer format, or does not fit the table.
        OSError: it cannot be read.
    """
    content, epoch_ns, topics, passed = LogContent(), 0, dict[int, str](), Counter[str]()
    for record in _records(path, content):
        if isinstance(record, Header):
            _check_profile(path, record)
        elif isinstance(record, Metadata) and record.name == METADATA:
            epoch_ns, content.config_yaml = _description(path, record)
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, McapMessage):
            topic = topics.get(record.channel_id, "")
            time_s = (record.log_time - epoch_ns) / 1e9
            if topic in BY_TOPIC:
                message = _decoded(path, topic, record.data, content)
                content.messages.append((time_s, message))
            else:
                passed[topic] += 1
    for topic, count in passed.items():
        content.remarks.append(f"{path.name}: {count} messages of {topic!r} were passed over.")
    return content


def _records(path: Path, content: LogContent) -> Iterator[McapRecord]:
    """Give the records; where the file is cut off or damaged it ends, with a remark."""
    ended = False
    # Of bytes in memory no more can be asked for than there are, whatever a damaged length says.
    file = io.BytesIO(path.read_bytes())
    reader = StreamReader(file, validate_crcs=True, record_size_limit=_MOST_BYTES_A_RECORD)
    try:
        for record in reader.records:
            ended = ended or isinstance(record, Footer)
            yield record
    except _BROKEN as error:
        if file.tell() <= 8:
            raise FlightFileError(_foreign(path)) from error
        if not ended:
            content.remarks.append(_cut_off(path, content))


def _cut_off(path: Path, content: LogContent) -> str:
    if not content.messages:
        return f"{path.name} is cut off or damaged before its first message."
    times = [time_s for time_s, message in content.messages if isinstance(message, StepRecord)]
    # Everything that people see of a flight counts from its first control step.
    length_s = content.messages[-1][0] - (times or [content.messages[0][0]])[0]
    return f"{path.name} is cut off or damaged after {length_s:.2f} s."


def _foreign(path: Path) -> str:
    return f"{path}: this is no log of a flight: it is not in the MCAP format"


def _check_profile(path: Path, header: Header) -> None:
    if header.profile != PROFILE:
        raise FlightFileError(
            f"{path}: this log was written by {header.library or 'another program'} with the "
            f"profile {header.profile!r}, not by follower; Foxglove can show what is in it"
        )


def _check_format(path: Path, number: int) -> None:
    if number > FORMAT:
        raise FlightFileError(
            f"{path}: the log has format {number}, this program reads up to {FORMAT}: update it; "
            f"{_OTHER_FILES}"
        )


def _description(path: Path, record: Metadata) -> tuple[int, str]:
    """Return the flight's time 0 in nanoseconds since 1970, and its configuration."""
    try:
        number, epoch_ns = int(record.metadata["format"]), int(record.metadata["epoch_ns"])
        config_yaml = record.metadata["config"]
    except (KeyError, ValueError) as error:
        raise FlightFileError(
            f"{path}: what the log says of itself is damaged ({error!r}); {_OTHER_FILES}"
        ) from error
    _check_format(path, number)
    return epoch_ns, config_yaml


def _decoded(path: Path, topic: str, data: bytes, before: LogContent) -> object:
    try:
        return decode(BY_TOPIC[topic].record, data)
    except ValueError as error:
        until_s = before.messages[-1][0] if before.messages else 0.0
        raise FlightFileError(
            f"{path}: a message of {topic} cannot be read: {error}; the {len(before.messages)} "
            f"messages before it, up to {until_s:.2f} s, could be; {_OTHER_FILES}"
        ) from error
