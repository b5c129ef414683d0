"""MAVLink 2 signing: what we send is signed, what is not signed rightly is refused."""

from __future__ import annotations

import hashlib
import hmac
from enum import StrEnum

from follower.links.packets import SIGNATURE, SIGNED_FLAG, Packet, checksum, crc_extra_of
from follower.links.signing_key import SigningKey

_V2 = 0xFD
_EPOCH_S = 1_420_070_400
"""2015-01-01, the zero of signing's time stamps, in seconds since 1970."""
_UNITS_PER_S = 100_000
_OLDEST_NEW_STREAM = 60 * _UNITS_PER_S
_LAST_STAMP = (1 << 48) - 1


class Refusal(StrEnum):
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
        link_id: tells several links of one sender apart.
    """

    def __init__(self, key: SigningKey, epoch_ns: int, link_id: int = 0) -> None:
        self._key = key
        self._epoch_s = epoch_ns / 1e9 - _EPOCH_S
        self._link_id = link_id
        self._stamp = 0
        self._heard: dict[tuple[int, int, int], int] = {}

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
        body += bytes((self._link_id,)) + self._stamp.to_bytes(6, "little")
        return body + self._signature(body)

    def refusal(self, packet: Packet, now_s: float) -> Refusal | None:
        """Return why a packet is not to be believed, None if it is."""
        if not packet.signed:
            return Refusal.UNSIGNED
        body, signature = packet.data[:-6], packet.data[-6:]
        if not hmac.compare_digest(self._signature(body), signature):
            return Refusal.WRONG
        trailer = packet.data[-SIGNATURE:]
        stream = (trailer[0], packet.system, packet.component)
        stamp = int.from_bytes(trailer[1:7], "little")
        newest = self._heard.get(stream)
        if newest is not None and stamp <= newest:
            return Refusal.REPLAYED
        if newest is None and stamp + _OLDEST_NEW_STREAM < max(self._stamp, self._present(now_s)):
            return Refusal.OLD
        self._heard[stream] = stamp
        # A computer without a clock of its own learns the time from the autopilot.
        self._stamp = max(self._stamp, stamp)
        return None

    def _present(self, now_s: float) -> int:
        return max(0, int((self._epoch_s + now_s) * _UNITS_PER_S))

    def _signature(self, body: bytes) -> bytes:
        return hashlib.sha256(self._key.secret + body).digest()[:6]
