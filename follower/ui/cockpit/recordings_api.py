"""The recorded flights of a folder."""

import re
from dataclasses import dataclass
from pathlib import Path

_LOG, _VIDEO, _REPORT = "flight.mcap", "video.mkv", "report.html"
_MOST_FLIGHTS = 200
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """One recorded flight.

    Attributes:
        name: of its folder.
        changed_s: when its log was written last, in seconds since 1970.
        megabytes: of log and video.
        has_video: whether frames were recorded.
        has_report: whether there is a report to read.
    """

    name: str
    changed_s: float
    megabytes: float
    has_video: bool
    has_report: bool


class RecordingFolder:
    """Looks into a folder of flights."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def listed(self) -> list[RecordingSummary]:
        """Return the newest flights, the newest first; one that cannot be reached is left out."""
        folders = [path.parent for path in self._folder.glob(f"*/{_LOG}")]
        found = [_flight(folder) for folder in folders if _NAME.fullmatch(folder.name)]
        flights = [flight for flight in found if flight is not None]
        newest = sorted(flights, key=lambda flight: flight.changed_s, reverse=True)
        return newest[:_MOST_FLIGHTS]

    def report(self, name: str) -> Path | None:
        """Return a flight's report, None if there is none. No name leads out of the folder."""
        if _NAME.fullmatch(name) is None or name not in {flight.name for flight in self.listed()}:
            return None
        path = self._folder / name / _REPORT
        return path if path.is_file() and not path.is_symlink() else None


def _flight(folder: Path) -> RecordingSummary | None:
    video = folder / _VIDEO
    try:
        log = (folder / _LOG).stat()
        size = log.st_size + (video.stat().st_size if video.is_file() else 0)
    except OSError:  # it was removed since the folder was read
        return None
    has_report = (folder / _REPORT).is_file()
    return RecordingSummary(
        folder.name, log.st_mtime, round(size / 1e6, 1), video.is_file(), has_report
    )
