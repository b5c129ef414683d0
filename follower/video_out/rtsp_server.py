"""A small RTSP server (RFC 2326) for one live stream and several viewers."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from follower.video_out.channel import Channel
from follower.video_out.rtsp_viewer import RtspViewer
from follower.video_out.settings import Address

_MOST_VIEWERS = 8


class RtspServer:
    """Serves rtsp://host:port/live, with RTP inside the connection or by UDP.

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
        self._viewers: set[asyncio.Task[None]] = set()
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
        task = asyncio.current_task()
        if task is None or len(self._viewers) >= _MOST_VIEWERS:
            writer.close()
            return
        self._viewers.add(task)
        viewer = RtspViewer(self._channel, reader, writer)
        try:
            with suppress(OSError, EOFError, asyncio.CancelledError):
                await viewer.run()
        finally:
            self._viewers.discard(task)
            viewer.close()
