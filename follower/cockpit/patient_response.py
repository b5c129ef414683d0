"""A stream of pictures for a browser that takes them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator

from fastapi.responses import StreamingResponse
from starlette.types import Message, Send

from follower.cockpit.mjpeg import BOUNDARY

_STUCK_S = 10.0


class PatientResponse(StreamingResponse):
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
