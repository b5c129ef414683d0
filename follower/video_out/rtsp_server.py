"""A small RTSP server (RFC 2326) for one live stream and several viewers."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from follower.video_out.channel import Channel
from follower.video_out.rtsp_viewer import RtspViewer
from follower.video_out.settings import Address

_MOST_VIEWERS, _MOST_OF_ONE_ADDRESS = 8, 4


class RtspServer:
    """Serves rtsp://host:port/live, with RTP inside the connection or by UDP.

    One address has at most half of the places; who does not play soon loses his.

    Args:
        channel: what is shown.
        address: to listen at; port 0 takes a free one.

    Attributes:
        port: that it listens at, once started.
    """

    def __init__(self, channel: Channel, address: Address) -> None:
        self._channel = channel
        self._address = address
        self._server: asyncio.Server | None = None
        self._viewers: dict[asyncio.Task[None], str] = {}
        self.port = address.port

    async def start(self) -> None:
        """Begin to listen.

        Raises:
            OSError: the address is taken or not ours.
        """
        self._server = await asyncio.start_server(
            self._serve, self._address.host, self._address.port
        )
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Listen no more, and leave every viewer."""
        if self._server is not None:
            self._server.close()
        for task in self._viewers:
            task.cancel()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task, peer = asyncio.current_task(), writer.get_extra_info("peername")
        address = str(peer[0]) if peer else ""
        if task is None or not self._has_place_for(address):
            writer.close()
            return
        self._viewers[task] = address
        viewer = RtspViewer(self._channel, reader, writer)
        try:
            with suppress(OSError, EOFError, asyncio.CancelledError):
                await viewer.run()
        finally:
            del self._viewers[task]
            viewer.close()

    def _has_place_for(self, address: str) -> bool:
        of_one = sum(other == address for other in self._viewers.values())
        return len(self._viewers) < _MOST_VIEWERS and of_one < _MOST_OF_ONE_ADDRESS
