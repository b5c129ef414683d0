"""Writes what is not video: the log and the telemetry log, on one thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from follower.flightlog import ControlRecord
from follower.recorder.append_file import BacklogError
from follower.recorder.config import FlightConfig
from follower.recorder.mcap_log import McapLog
from follower.recorder.records import SetpointRecord, StepRecord
from follower.recorder.tlog import Direction, TlogWriter
from follower_vision.framesource import ClosesItself

LOG, TLOG = "flight.mcap", "mavlink.tlog"


@dataclass(frozen=True, slots=True)
class Bytes:
    """What went over the link, not yet cut into packets."""

    data: bytes
    direction: Direction


Entry = tuple[object, float]
"""A message, a `ControlRecord` or `Bytes`, and its time on the flight's clock."""


class LogWriter(ClosesItself):
    """Takes messages, encodes them, and commits them when told to.

    A full disk is told to `tell` once; what cannot be written waits, and is written when there is
    room again. When too much waits, the log ends there.

    Raises:
        OSError: by the constructor, if the files cannot be made.
    """

    def __init__(self, folder: Path, config: FlightConfig, tell: Callable[[str], None]) -> None:
        self._log = McapLog(folder / LOG, config.epoch_ns, config.to_yaml())
        self._tlog = TlogWriter(folder / TLOG, config.epoch_ns)
        self._tell = tell
        self._failing = self._ended = False

    def write(self, message: object, time_s: float) -> None:
        """Encode a message of the table, or `Bytes`."""
        if self._ended:
            return
        if isinstance(message, Bytes):
            self._tlog.write(message.data, message.direction, time_s)
        else:
            self._log.write(message, time_s)

    def commit(self) -> None:
        """Put everything onto the disk, if the disk allows."""
        if self._ended:
            return
        try:
            self._log.commit()
            self._tlog.commit()
        except BacklogError:
            self._ended = True
            self._tell("the log ends here: the disk has been full for too long")
        except OSError as error:
            if not self._failing:
                self._tell(f"the log cannot be written ({error.strerror}) and waits in memory")
            self._failing = True
        else:
            if self._failing:
                self._tell("the log is written again, nothing is missing in it")
            self._failing = False

    def close(self) -> None:
        """Commit and finish the files, as far as the disk allows."""
        for file in (self._log, self._tlog):
            try:
                file.close()
            except OSError as error:
                self._tell(f"the log's end could not be written ({error.strerror})")


def messages_of(entry: Entry) -> list[Entry]:
    """Return the messages that an entry is cut into."""
    record, time_s = entry
    if isinstance(record, ControlRecord):
        return [(part, time_s) for part in control_messages(record)]
    return [entry]


def control_messages(record: ControlRecord) -> list[object]:
    """Return the messages that a control step is cut into, in their order."""
    told = record.situation, record.estimate, record.gimbal
    parts = (*record.attitudes, record.health, record.vehicle, *told)
    return [
        *(part for part in parts if part is not None),
        SetpointRecord(record.asked, record.allowed, record.limits, record.sent),
        StepRecord(
            record.time_s,
            record.late_s,
            record.busy_s,
            record.state,
            record.reason,
            record.track_sequence,
            record.track_captured_s,
            record.mode_asked,
            record.changes,
        ),
    ]
