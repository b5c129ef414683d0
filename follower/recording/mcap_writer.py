"""Writes `flight.mcap`: messages as JSON with their schemas, in chunks that stand by themselves."""

import io
import json
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, cast

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Footer, Header, McapRecord, Metadata
from mcap.records import Message as McapMessage
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import CompressionType, Writer

from follower.recording.append_file import AppendFile
from follower.recording.codec import decode, encode, json_schema, schema_name
from follower.recording.messages import BY_TOPIC, MESSAGES, StepRecord
from follower_vision.sources.frame_source import ClosesItself, SourceError

PROFILE = "drone-target-follower"
FORMAT = 1
"""Raised when a log can no longer be read by programs that know the number before."""
METADATA = "flight"
_CHUNK_BYTES = 1 << 30
"""A chunk is ended by each commit, not by its size."""


class McapLog(ClosesItself):
    """Writes messages into an MCAP file; what was committed can be read whatever happens then.

    Args:
        path: must not exist yet.
        epoch_ns: what the flight's time 0 is in nanoseconds since 1970, UTC.
        config_yaml: goes into the file's metadata, so that the log explains itself.

    Raises:
        OSError: the file cannot be made; by `commit` and `close`: the disk is full.
    """

    def __init__(self, path: Path, epoch_ns: int, config_yaml: str = "") -> None:
        self._file = AppendFile(path)
        self._epoch_ns = epoch_ns
        self._writer: Any = Writer(
            cast(IO[bytes], self._file),
            chunk_size=_CHUNK_BYTES,
            compression=CompressionType.ZSTD,
        )
        self._writer.start(PROFILE, f"follower format {FORMAT}")
        content = {"format": str(FORMAT), "epoch_ns": str(epoch_ns), "config": config_yaml}
        self._writer.add_metadata(METADATA, content)
        self._channels = self._registered()
        self._counts = dict.fromkeys(self._channels, 0)
        self._finished = False

    def write(self, record: object, time_s: float) -> None:
        """Add a message, a dataclass of the table, at a time on the flight's clock."""
        kind = type(record)
        self._counts[kind] += 1
        stamp_ns = max(0, self._epoch_ns + round(time_s * 1e9))
        channel = self._channels[kind]
        self._writer.add_message(channel, stamp_ns, encode(record), stamp_ns, self._counts[kind])

    def commit(self) -> None:
        """Put all messages onto the disk."""
        self._writer.flush()
        self._file.commit()

    def close(self) -> None:
        """Write the index, without which the file can be read as well, and close it."""
        if self._finished:
            return
        self._finished = True
        try:
            self._writer.finish()
            self._file.commit()
        finally:
            self._file.close()

    def _registered(self) -> dict[type, int]:
        channels = {}
        for message in MESSAGES:
            schema = json.dumps(json_schema(message), ensure_ascii=False).encode()
            schema_id = self._writer.register_schema(schema_name(message), "jsonschema", schema)
            channels[message.record] = self._writer.register_channel(
                message.topic, "json", schema_id, {"rate": message.rate}
            )
        return channels


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
    """A flight cannot be read; the message says which file, why, and what could be read.

    Examples:
        >>> import follower
        >>> try:
        ...     follower.open_flight("runs/gone")
        ... except follower.FlightFileError as error:
        ...     print(error)
        runs/gone: there is no such folder; a flight is a folder with flight.mcap in it
    """


@dataclass(slots=True)
class LogContent:
    """What was in a log.

    Attributes:
        messages: (seconds on the flight's clock, dataclass of the table), in the order written.
        config_yaml: the configuration that the log carries, "" if it does not.
        remarks: what is missing or was passed over, in sentences.
        whole: it was closed; False where it is cut off.
    """

    messages: list[tuple[float, object]] = field(default_factory=list)
    config_yaml: str = ""
    remarks: list[str] = field(default_factory=list)
    whole: bool = True


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
            raise FlightFileError(
                f"{path}: this is no log of a flight: it is not in the MCAP format"
            ) from error
        if not ended:
            content.whole = False
            content.remarks.append(_cut_off(path, content))


def _cut_off(path: Path, content: LogContent) -> str:
    if not content.messages:
        return f"{path.name} is cut off or damaged before its first message."
    times = [time_s for time_s, message in content.messages if isinstance(message, StepRecord)]
    # Everything that users see of a flight counts from its first control step.
    length_s = content.messages[-1][0] - (times or [content.messages[0][0]])[0]
    return f"{path.name} is cut off or damaged after {length_s:.2f} s."


def _check_profile(path: Path, header: Header) -> None:
    if header.profile != PROFILE:
        raise FlightFileError(
            f"{path}: this log was written by {header.library or 'another program'} with the "
            f"profile {header.profile!r}, not by follower; Foxglove can show what is in it"
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
    if number > FORMAT:
        raise FlightFileError(
            f"{path}: the log has format {number}, this program reads up to {FORMAT}: update it; "
            f"{_OTHER_FILES}"
        )
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
