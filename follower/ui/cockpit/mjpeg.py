"""The page's video as JPEG pictures, where WebRTC fails."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator

import cv2
from fastapi.responses import StreamingResponse
from starlette.types import Message, Send

from follower.ui.video.channel import Picture
from follower.ui.video.h264_encoder import fitted

BOUNDARY = "picture"
_QUALITY = 70
_MOST_WIDTH_PX = 960
_LEAST_BETWEEN_S = 1 / 20
_MOST_READERS = 8
_STUCK_S = 10.0


class JpegStream:
    """The newest picture for each reader, encoded once for all and only while there are readers.

    A slow reader misses pictures, and nothing waits for it.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._readers = 0
        self._jpeg = b""
        self._shown_s = 0.0
        self._new = asyncio.Event()

    @property
    def full(self) -> bool:
        """Whether there are as many readers as may be."""
        return self._readers >= _MOST_READERS

    def show(self, picture: Picture) -> None:
        """Encode a picture if anybody reads; called on the studio's thread."""
        early = 0 <= picture.captured_s - self._shown_s < _LEAST_BETWEEN_S
        if self._readers == 0 or early:
            return
        self._shown_s = picture.captured_s
        image = fitted(picture.image, _MOST_WIDTH_PX)
        _, jpeg = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))
        with contextlib.suppress(RuntimeError):  # the loop was closed meanwhile
            self._loop.call_soon_threadsafe(self._take, jpeg.tobytes())

    async def parts(self) -> AsyncGenerator[bytes]:
        """Give the parts of a multipart/x-mixed-replace answer."""
        self._readers += 1
        try:
            while True:
                await self._new.wait()
                jpeg = self._jpeg
                head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}"
                yield head.encode() + b"\r\n\r\n" + jpeg + b"\r\n"
        finally:
            self._readers -= 1

    def _take(self, jpeg: bytes) -> None:
        self._jpeg = jpeg
        self._new.set()
        self._new = asyncio.Event()


class MjpegResponse(StreamingResponse):
    """Sends parts until the browser leaves, or has taken nothing for ten seconds.

    One that stays and takes nothing would keep a place that others want.

    Args:
        parts: of a multipart/x-mixed-replace answer.
    """

    def __init__(self, parts: AsyncGenerator[bytes]) -> None:
        super().__init__(parts, media_type=f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self._parts = parts

    async def stream_response(self, send: Send) -> None:
        """Send the parts."""

        async def send_in_time(event: Message) -> None:
            async with asyncio.timeout(_STUCK_S):
                await send(event)

        with contextlib.suppress(TimeoutError):
            async with contextlib.aclosing(self._parts):
                await super().stream_response(send_in_time)
