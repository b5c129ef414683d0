"""Makes a simulated autopilot one that signs."""

from __future__ import annotations

from pathlib import Path

from follower.links.packets import PacketReader
from follower.links.signing import Signer
from follower.links.signing_key import SigningKey
from follower_control.transport import Transport
from follower_vision.clock import Clock

_SECRET = bytes(range(1, 33))


def write_key(folder: Path) -> Path:
    """Write a file with the key that `SigningPeer` has, and return its path."""
    path = folder / "fault.key"
    path.write_text(_SECRET.hex())
    path.chmod(0o600)
    return path


class SigningPeer:
    """A transport of the autopilot's that signs what leaves and drops what is not signed."""

    def __init__(self, inner: Transport, clock: Clock, epoch_ns: int) -> None:
        self._inner = inner
        self._clock = clock
        self._signer = Signer(SigningKey(_SECRET), epoch_ns)
        self._reader = PacketReader()

    def send(self, data: bytes) -> None:
        """Send one packet, signed."""
        self._inner.send(self._signer.sign(data, self._clock.now()))

    def receive(self) -> bytes:
        """Return what has arrived with the right signature."""
        now_s = self._clock.now()
        packets = self._reader.feed(self._inner.receive())
        return b"".join(p.data for p in packets if self._signer.refusal(p, now_s) is None)

    def close(self) -> None:
        """Close the transport."""
        self._inner.close()
