"""The secret of MAVLink 2 signing, read from a file and never shown."""

from __future__ import annotations

import hashlib
import re
import stat
from pathlib import Path

from follower.links.connection import ConnectionFailedError

_LENGTH = 32
_HEX = re.compile(rb"[0-9a-fA-F]{64}")
_LONGEST_FILE = 4096


class SigningKeyError(ConnectionFailedError):
    """The key file cannot be used; the message says why, and nothing of what is in it."""


class SigningKey:
    """Thirty-two secret bytes. Printing it, or anything that holds it, does not show them."""

    __slots__ = ("secret",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != _LENGTH:
            raise SigningKeyError(f"a signing key has {_LENGTH} bytes, not {len(secret)}")
        self.secret = secret

    def __repr__(self) -> str:
        return "SigningKey(hidden)"

    def __reduce__(self) -> str:
        raise TypeError("a signing key is not written anywhere")

    @classmethod
    def from_file(cls, path: str | Path) -> SigningKey:
        """Read a key: 32 raw bytes, 64 hexadecimal digits, or else a passphrase.

        A passphrase becomes a key by SHA-256, as in MAVProxy and QGroundControl; white space at
        its ends does not count.

        Raises:
            SigningKeyError: there is no such file, others may read it, or it holds no key.
        """
        path = Path(path)
        try:
            mode = path.stat().st_mode
            data = path.read_bytes()[: _LONGEST_FILE + 1]
        except OSError as error:
            reason = error.strerror or str(error)
            raise SigningKeyError(f"signing key {path}: {reason}") from error
        if mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise SigningKeyError(
                f"signing key {path}: others may read or change it (mode {stat.S_IMODE(mode):o}); "
                f"make it yours alone: chmod 600 {path}"
            )
        return cls(_secret(path, data))


def _secret(path: Path, data: bytes) -> bytes:
    text = data.strip()
    if _HEX.fullmatch(text):
        return bytes.fromhex(text.decode("ascii"))
    if len(data) == _LENGTH and not _is_text(data):
        return data
    if not text or len(data) > _LONGEST_FILE or not _is_text(text):
        raise SigningKeyError(
            f"signing key {path}: write 32 raw bytes, 64 hexadecimal digits or a passphrase"
        )
    return hashlib.sha256(text).digest()


def _is_text(data: bytes) -> bool:
    try:
        return data.decode("utf-8").strip().isprintable()
    except UnicodeDecodeError:
        return False
