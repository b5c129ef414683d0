"""A file that only grows, by whole pieces, and survives a full disk and a power cut."""

import os
from pathlib import Path

from follower_vision.sources.frame_source import ClosesItself

_MOST_PENDING = 16_000_000

write_some = os.write
"""Writes to a descriptor what it can and returns how much; a simulated full disk replaces it."""


class BacklogError(OSError):
    """The disk has been full for so long that what waits for it is given up."""


class AppendFile(ClosesItself):
    """Collects what is written; `commit` puts it on the disk, all of it or nothing.

    If the disk is full the file keeps its last whole piece, and what waits is tried again with the
    next commit, up to 16 MB. It has the `write`, `tell` and `flush` of a binary file.

    Attributes:
        path: where it is.

    Raises:
        OSError: by the constructor, if the file cannot be made; it must not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        self._descriptor = os.open(path, flags, 0o644)
        self._pending: list[bytes] = []
        self._pending_size = 0
        self._size = 0

    def write(self, data: bytes) -> int:
        """Take a piece; it is in the file after the next `commit`."""
        self._pending.append(data)
        self._pending_size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return how long the file will be."""
        return self._size + self._pending_size

    def flush(self) -> None:
        """Do nothing: `commit` decides when."""

    def commit(self) -> None:
        """Put what waits into the file and onto the disk, which may take its time.

        Raises:
            OSError: the disk is full or broken; the file is as it was before.
            BacklogError: and more waits than can be kept.
        """
        if not self._pending:
            return
        data = b"".join(self._pending)
        try:
            self._write_all(data)
            os.fdatasync(self._descriptor)
        except OSError as error:
            error.filename = str(self.path)
            os.ftruncate(self._descriptor, self._size)
            os.lseek(self._descriptor, self._size, os.SEEK_SET)
            self._pending = [data]
            if len(data) > _MOST_PENDING:
                raise BacklogError(error.errno, error.strerror, error.filename) from error
            raise
        self._size += len(data)
        self._pending = []
        self._pending_size = 0

    def close(self) -> None:
        """Close the file without another commit."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _write_all(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[write_some(self._descriptor, rest) :]
