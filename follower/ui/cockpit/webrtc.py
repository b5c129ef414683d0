"""The page's video by WebRTC: the stream's own H.264, packed anew for each browser."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import aioice.ice
import av
from aiortc import (
    MediaStreamTrack,
    RTCConfiguration,
    RTCPeerConnection,
    RTCRtpSender,
    RTCSessionDescription,
)
from aiortc.exceptions import InternalError, InvalidAccessError, InvalidStateError, OperationError
from aiortc.mediastreams import MediaStreamError

from follower.ui.video.channel import VideoChannel
from follower.ui.video.h264_encoder import TICKS_PER_S, AccessUnit

_MOST_PEERS = 8
_WAITING = 8
_CONNECTS_WITHIN_S = 20.0
_UNREADABLE = (
    *(ValueError, AttributeError, KeyError, IndexError, AssertionError, TypeError),
    *(InternalError, InvalidAccessError, InvalidStateError, OperationError),
)
"""aiortc says by any of these that it cannot read an offer."""
_TIME_BASE = Fraction(1, TICKS_PER_S)


class OfferError(ValueError):
    """A browser's offer cannot be answered."""


class StreamTrack(MediaStreamTrack):
    """The channel's pictures for one browser. After a gap it begins again with a key picture."""

    kind = "video"

    def __init__(self, channel: VideoChannel) -> None:
        super().__init__()
        self._channel = channel
        self._home = asyncio.get_running_loop()
        self._units: asyncio.Queue[AccessUnit | None] = asyncio.Queue(_WAITING)
        self._needs_key = True
        self._leave: Callable[[], None] = channel.watch(self._hand_over)

    async def recv(self) -> av.Packet[Any]:
        """Return the next picture, encoded."""
        unit = await self._units.get()
        if unit is None or self.readyState != "live":
            raise MediaStreamError
        packet: av.Packet[Any] = av.Packet(unit.data)
        packet.pts = packet.dts = unit.ticks
        packet.time_base = _TIME_BASE
        return packet

    def stop(self) -> None:
        """Watch no longer."""
        super().stop()
        self._leave()

    def _hand_over(self, unit: AccessUnit) -> None:
        with contextlib.suppress(RuntimeError):  # the loop was closed meanwhile
            self._home.call_soon_threadsafe(self._take, unit)

    def _take(self, unit: AccessUnit) -> None:
        full = self._units.full()
        self._needs_key = full or (self._needs_key and not unit.is_key)
        if not self._needs_key:
            self._units.put_nowait(unit)
        elif not full:  # who takes nothing is not to make every picture a key picture
            self._channel.ask_for_key()


class WebRtcPeers:
    """The browsers that watch by WebRTC.

    Args:
        channel: what they see.
        local_only: do not leave this computer.
    """

    def __init__(self, channel: VideoChannel, local_only: bool) -> None:
        self._channel = channel
        self._peers: set[RTCPeerConnection] = set()
        self._watches: set[asyncio.Task[None]] = set()
        if local_only:
            # aioice offers every address but this one, and has no setting for it.
            aioice.ice.get_host_addresses = _loopback_alone

    async def answer(self, sdp: str) -> str:
        """Return the answer to a browser's offer, both as SDP.

        Raises:
            OfferError: it is no offer, has no H.264, or there are too many browsers.
        """
        if len(self._peers) >= _MOST_PEERS:
            raise OfferError("too many watch already")
        peer = RTCPeerConnection(RTCConfiguration(iceServers=[]))
        self._peers.add(peer)  # before anything is waited for: others ask meanwhile
        track = StreamTrack(self._channel)
        async with contextlib.AsyncExitStack() as undoing:
            undoing.push_async_callback(self._end, peer, track)
            try:
                await _settle(peer, track, sdp)
            except _UNREADABLE as error:
                raise OfferError(f"this offer cannot be answered: {error}") from None
            undoing.pop_all()
        self._keep(peer, track)
        return str(peer.localDescription.sdp)

    async def close(self) -> None:
        """Show nobody any more."""
        for peer in tuple(self._peers):
            await peer.close()

    async def _end(self, peer: RTCPeerConnection, track: StreamTrack) -> None:
        track.stop()
        self._peers.discard(peer)
        await peer.close()

    def _keep(self, peer: RTCPeerConnection, track: StreamTrack) -> None:
        async def look() -> None:
            if peer.connectionState in ("failed", "closed", "disconnected"):
                await self._end(peer, track)

        async def watch() -> None:
            await asyncio.sleep(_CONNECTS_WITHIN_S)
            if peer.connectionState != "connected":
                await self._end(peer, track)

        peer.on("connectionstatechange", look)
        task = asyncio.create_task(watch())
        self._watches.add(task)
        task.add_done_callback(self._watches.discard)


async def _settle(peer: RTCPeerConnection, track: StreamTrack, sdp: str) -> None:
    """Read a browser's offer and make the answer to it."""
    peer.addTrack(track)
    # aiortc settles on a codec while it reads the offer.
    codecs = RTCRtpSender.getCapabilities("video").codecs
    wanted = [codec for codec in codecs if codec.mimeType.lower() == "video/h264"]
    for transceiver in peer.getTransceivers():
        if transceiver.kind == "video":
            transceiver.setCodecPreferences(wanted)
    await peer.setRemoteDescription(RTCSessionDescription(sdp, "offer"))
    await peer.setLocalDescription(await peer.createAnswer())


def _loopback_alone(use_ipv4: bool, use_ipv6: bool) -> list[str]:
    """Return the addresses to offer on a computer that shows its page to itself alone."""
    del use_ipv6
    return ["127.0.0.1"] if use_ipv4 else []
