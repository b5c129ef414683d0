"""Fetch one file over HTTP: resumed, verified, and there as a whole or not at all."""

import fcntl
import hashlib
import http.client
import os
import shutil
import urllib.error
import urllib.request
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from typing import TypeAlias
from urllib.parse import urlsplit

from follower_vision.disk import is_no_room
from follower_vision.models.table import ModelFile
from follower_vision.onnx_network import ModelError

Progress: TypeAlias = Callable[[int, int], None]
"""Called with the bytes that are there and those wanted."""

_CHUNK_BYTES = 1 << 16
_TIMEOUT_S = 20.0
_MOST_TRIES = 5


class DownloadError(ModelError):
    """A file could not be fetched; the message is one line that says what to do."""


class AddressError(DownloadError):
    """This address did not give the file; another may."""


class RangeError(AddressError):
    """The server cannot go on from what is there."""


class BrokenTransferError(AddressError):
    """The transfer ended early; what has come is kept, and the next try goes on from there."""


def sha256_of(path: Path) -> str:
    """Return a file's sha256 in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def fetch(file: ModelFile, target: Path, progress: Progress) -> None:
    """Fetch a file from the first of its addresses that gives it.

    What has come of it is kept beside the target as NAME.part until it is whole and right.

    Raises:
        DownloadError: no address gave the file, or there is no room for it.
    """
    if not file.addresses:
        raise DownloadError(f"{file.name} has no address; put your own copy at {target}")
    failures: dict[str, None] = {}
    for address in file.addresses:
        try:
            _fetch_from(address, file, target, progress)
        except AddressError as error:
            failures[str(error)] = None
        else:
            return
    advice = f"try again, or fetch it by other means and put it at {target}"
    raise DownloadError(f"{file.name}: {'; '.join(failures)}; {advice}")


def _fetch_from(address: str, file: ModelFile, target: Path, progress: Progress) -> None:
    part = target.with_name(f"{target.name}.part")
    resumed = _size(part) > 0
    _complete(address, file, part, progress)
    if sha256_of(part) != file.sha256 and resumed:
        # The part may have been of another version; a whole transfer settles it.
        part.unlink()
        _complete(address, file, part, progress)
    if sha256_of(part) != file.sha256:
        part.unlink()
        raise AddressError(f"{address} gives another file than expected (wrong sha256)")
    part.replace(target)


def _complete(address: str, file: ModelFile, part: Path, progress: Progress) -> None:
    """Transfer what is missing, again as long as every try brings something."""
    for _ in range(_MOST_TRIES):
        before = _size(part)
        if before == file.size_bytes:
            return
        try:
            _transfer(address, file, part, progress)
        except RangeError:
            part.unlink()
        except BrokenTransferError:
            if _size(part) <= before:
                raise
    if _size(part) != file.size_bytes:
        raise BrokenTransferError(f"{address} broke off {_MOST_TRIES} times")


def _transfer(address: str, file: ModelFile, part: Path, progress: Progress) -> None:
    """Append to the part what the server gives from there on."""
    have = _size(part)
    if have > file.size_bytes:
        part.unlink()
        have = 0
    _check_room(part.parent, file.size_bytes - have)
    with _open(address, have) as answer:
        _check_stated_size(answer, file)
        goes_on = answer.status == http.client.PARTIAL_CONTENT
        with _open_part(part, append=goes_on) as out:
            _copy(answer, out, file, progress)
    if _size(part) < file.size_bytes:
        raise BrokenTransferError(
            f"{address} broke off after {_size(part)} of {file.size_bytes} bytes"
        )


def _open(address: str, start: int) -> http.client.HTTPResponse:
    if urlsplit(address).scheme not in ("http", "https"):
        raise AddressError(f"{address} is no http address")
    headers = {"User-Agent": "follower"} | ({"Range": f"bytes={start}-"} if start else {})
    request = urllib.request.Request(address, headers=headers)  # noqa: S310  checked above
    try:
        answer: http.client.HTTPResponse = urllib.request.urlopen(  # noqa: S310
            request, timeout=_TIMEOUT_S
        )
    except urllib.error.HTTPError as error:
        error.close()
        refused = error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE
        kind = RangeError if refused else AddressError
        raise kind(f"{address} answers {error.code} {error.reason}") from error
    except urllib.error.URLError as error:
        reason = f"cannot reach {urlsplit(address).netloc} ({error.reason})"
        raise AddressError(f"{reason}; is there a network?") from error
    except (http.client.HTTPException, OSError) as error:
        raise BrokenTransferError(f"{address} broke off ({error})") from error
    return answer


def _check_stated_size(answer: http.client.HTTPResponse, file: ModelFile) -> None:
    """Refuse, say, a hotel's login page before it takes the place of what has come."""
    if answer.status == http.client.PARTIAL_CONTENT:
        stated = (answer.headers.get("Content-Range") or "").rpartition("/")[2]
    else:
        stated = answer.headers.get("Content-Length") or ""
    if stated.isdecimal() and int(stated) != file.size_bytes:
        raise AddressError(
            f"{answer.url} gives another file than expected "
            f"({stated} bytes instead of {file.size_bytes})"
        )


def _open_part(part: Path, append: bool) -> FileIO:
    """Open the part for this process alone."""
    try:
        out = part.open("ab", buffering=0)  # closing it then writes nothing that could fail
    except OSError as error:
        raise DownloadError(f"cannot write {part}: {error.strerror}") from error
    try:
        fcntl.flock(out, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        out.close()
        raise DownloadError(f"{part} is being fetched by another process; wait for it") from error
    if not append:
        out.truncate(0)
        out.seek(0)
    return out


def _copy(
    answer: http.client.HTTPResponse, out: FileIO, file: ModelFile, progress: Progress
) -> None:
    written = out.tell()
    while chunk := _read(answer):
        written += len(chunk)
        if written > file.size_bytes:
            raise AddressError(f"{answer.url} gives more than {file.size_bytes} bytes")
        _write(out, chunk, file)
        progress(written, file.size_bytes)
    _write(out, b"", file)


def _read(answer: http.client.HTTPResponse) -> bytes:
    try:
        return answer.read(_CHUNK_BYTES)
    except (http.client.HTTPException, OSError) as error:
        raise BrokenTransferError(f"{answer.url} broke off ({error})") from error


def _write(out: FileIO, chunk: bytes, file: ModelFile) -> None:
    try:
        if not chunk:
            os.fsync(out.fileno())
        rest = memoryview(chunk)
        while rest:
            rest = rest[out.write(rest) :]
    except OSError as error:
        if is_no_room(error):
            raise _no_room(Path(out.name).parent, file.size_bytes) from error
        raise DownloadError(f"cannot write {out.name}: {error.strerror}") from error


def _check_room(folder: Path, wanted_bytes: int) -> None:
    if shutil.disk_usage(folder).free < wanted_bytes:
        raise _no_room(folder, wanted_bytes)


def _no_room(folder: Path, wanted_bytes: int) -> DownloadError:
    return DownloadError(
        f"no room for {wanted_bytes / 1e6:.1f} MB in {folder}; make room, "
        "or set FOLLOWER_MODELS to a folder elsewhere"
    )


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
