"""MAVLink 2 signing: what we send is signed, what is not signed rightly is refused."""

from __future__ import annotations

import hashlib
import hmac
import re
import stat
from enum import StrEnum
from pathlib import Path

from follower.links.connections import ConnectionFailedError
from follower.links.packet_parser import (
    SIGNATURE,
    SIGNED_FLAG,
    MavlinkPacket,
    checksum,
    crc_extra_of,
)

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


_V2 = 0xFD
_EPOCH_S = 1_420_070_400
"""2015-01-01, the zero of signing's time stamps, in seconds since 1970."""
_UNITS_PER_S = 100_000
_OLDEST_NEW_STREAM = 60 * _UNITS_PER_S
_LAST_STAMP = (1 << 48) - 1


class SignatureRefusal(StrEnum):
    """Why a packet is not believed."""

    UNSIGNED = "not signed"
    WRONG = "wrong signature"
    REPLAYED = "replayed or out of order"
    OLD = "signed more than a minute ago"


class Signer:
    """Signs packets and checks signatures, for one link.

    pymavlink's own check remembers a packet's time stamp before it knows that the signature is
    right, so that one forged packet with a late stamp shuts out the true sender; this one does
    not.

    Args:
        key: the secret.
        epoch_ns: the clock's time 0 in nanoseconds since 1970, UTC.
    """

    def __init__(self, key: SigningKey, epoch_ns: int) -> None:
        self._key = key
        self._epoch_s = epoch_ns / 1e9 - _EPOCH_S
        self._stamp = 0
        self._newest: dict[tuple[int, int, int], int] = {}

    def sign(self, packet: bytes, now_s: float) -> bytes:
        """Return a packet with a signature; the time stamps rise from packet to packet.

        Raises:
            ValueError: it is no unsigned MAVLink 2 packet of a message that is known.
        """
        crc_extra = crc_extra_of(int.from_bytes(packet[7:10], "little"))
        if packet[0] != _V2 or packet[2] & SIGNED_FLAG or crc_extra is None:
            raise ValueError("only an unsigned MAVLink 2 packet of a known message is signed")
        self._stamp = min(max(self._stamp + 1, self._present(now_s)), _LAST_STAMP)
        body = packet[:2] + bytes((packet[2] | SIGNED_FLAG,)) + packet[3:-2]
        body += checksum(body, crc_extra)
        body += bytes(1) + self._stamp.to_bytes(6, "little")
        return body + self._signature(body)

    def refusal(self, packet: MavlinkPacket, now_s: float) -> SignatureRefusal | None:
        """Return why a packet is not to be believed, None if it is."""
        if not packet.signed:
            return SignatureRefusal.UNSIGNED
        body, signature = packet.data[:-6], packet.data[-6:]
        if not hmac.compare_digest(self._signature(body), signature):
            return SignatureRefusal.WRONG
        trailer = packet.data[-SIGNATURE:]
        stream = (trailer[0], packet.system, packet.component)
        stamp = int.from_bytes(trailer[1:7], "little")
        newest = self._newest.get(stream)
        if newest is not None and stamp <= newest:
            return SignatureRefusal.REPLAYED
        if newest is None and stamp + _OLDEST_NEW_STREAM < max(self._stamp, self._present(now_s)):
            return SignatureRefusal.OLD
        self._newest[stream] = stamp
        # A computer without a clock of its own learns the time from the autopilot.
        self._stamp = max(self._stamp, stamp)
        return None

    def _present(self, now_s: float) -> int:
        return max(0, int((self._epoch_s + now_s) * _UNITS_PER_S))

    def _signature(self, body: bytes) -> bytes:
        return hashlib.sha256(self._key.secret + body).digest()[:6]
