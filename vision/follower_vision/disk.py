"""Files on a disk that may be full: written whole or not at all, and what the reader is told."""

import errno
import os
import shutil
from contextlib import suppress
from pathlib import Path

_DRAFT_NAME = 60
"""So many last characters, by which names differ, are in a draft's name: it has 255 bytes, too."""


def write_whole(path: Path, text: str) -> Path:
    """Write a file under another name first, so that a reader never sees half of it.

    Raises:
        OSError: it cannot be written; `filename` is the file's, and nothing of it is left.
    """
    return write_whole_bytes(path, text.encode("utf-8", "replace"))  # a name may be no UTF-8


def write_whole_bytes(path: Path, content: bytes) -> Path:
    """Do the same with bytes.

    Through a link the file that it leads to is written. What is no file, as /dev/stdout, cannot be
    put in place of another: it is written to at once.
    """
    file = Path(os.path.realpath(path))
    draft = file.with_name(f".{file.name[-_DRAFT_NAME:]}.part")
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(content)
        else:
            draft.write_bytes(content)
            draft.replace(file)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from None
    finally:
        with suppress(OSError):
            draft.unlink()
    return path


_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NO_WRITING = (errno.EROFS, errno.EACCES, errno.EPERM)


def is_no_room(error: OSError) -> bool:
    """Whether a write failed because disk, quota or largest file size are used up."""
    return error.errno in _NO_ROOM


def is_unwritable(error: OSError) -> bool:
    """Whether a write failed in a way that another place may not: no room, or not allowed."""
    return error.errno in (*_NO_ROOM, *_NO_WRITING)


def free_bytes(place: Path) -> int | None:
    """Return the room on a file's or folder's disk, which may not exist yet; None is unknown."""
    try:
        return shutil.disk_usage(_nearest(place)).free
    except OSError:
        return None


def is_short_of_room(place: Path, wanted_mb: float) -> bool:
    """Whether a file's or folder's disk surely has less room than so many megabytes."""
    free = free_bytes(place)
    return free is not None and free < 1e6 * wanted_mb


def can_be_written(folder: Path) -> bool:
    """Whether this user may put files into a folder, which may not exist yet."""
    try:
        there = _nearest(folder)
        return there.is_dir() and os.access(there, os.W_OK | os.X_OK)
    except OSError:
        return False


def _nearest(place: Path) -> Path:
    return next(one for one in (place, *place.absolute().parents) if one.exists())


def room_said(place: Path) -> str:
    """Return a file's or folder's name with what is free on its disk, in words."""
    free = free_bytes(place)
    return f"{place}, {'unknown' if free is None else f'{free / 1e6:.1f} MB'} free"


def failure_said(error: OSError, place: Path) -> str:
    """Return why a file could not be written, with its name and what is free."""
    return f"{error.strerror or error} ({room_said(place)})"
