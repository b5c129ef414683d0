"""Writes `flight.mcap`: messages as JSON with their schemas, in chunks that stand by themselves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import IO, Any, cast

from mcap.writer import CompressionType, Writer

from follower.recorder.append_file import AppendFile
from follower.recorder.codec import encode
from follower.recorder.messages import MESSAGES
from follower.recorder.schema import json_schema, schema_name
from follower_vision.framesource import ClosesItself

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
