"""The station's process: `python -m follower.station.child WIRE IMAGE`, started by `Station`.

The first message is `begin`:

| key       | value                                                           |
|-----------|-----------------------------------------------------------------|
| `video`   | settings of the video that goes out                             |
| `cockpit` | settings of the page, or nothing without one                    |
| `page`    | what the page is to know from the start: mode, settings, title  |
| `runs`    | folder with the flights                                         |
| `detector`| name of the detector that numbers what may be tapped, or nothing|
"""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import cv2
from pydantic import TypeAdapter

from follower.station.shared_image import SharedImage
from follower.station.studio import Studio
from follower.station.wire import FROM_FLIGHT_BYTES, Message, Wire, WireError
from follower.video_out.rtsp_server import RtspServer
from follower.video_out.settings import Address, VideoSettings

_POLITENESS = 5
"""The flight's threads come first where cores are few."""


def main() -> None:
    """Serve until the flight hangs up."""
    _give_way()
    cv2.setNumThreads(1)
    wire = Wire(Connection(int(sys.argv[1])), FROM_FLIGHT_BYTES)
    image = SharedImage(int(sys.argv[2]))
    begin = wire.receive()
    if begin["kind"] != "begin":
        raise WireError(f"expected to begin, not {begin['kind']}")
    asyncio.run(_serve(begin, wire, image))


def _give_way() -> None:
    """Come after the flight, also where that has a real-time priority, which a child inherits."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(_POLITENESS)


async def _serve(begin: Message, wire: Wire, image: SharedImage) -> None:
    video = TypeAdapter(VideoSettings).validate_python(begin["video"])
    studio = Studio(video)
    receiver = _Receiver(wire, image, studio)
    rtsp = await _rtsp(video, studio, wire)
    studio.start_senders(lambda text: _say(wire, text))
    if begin.get("cockpit") is not None:
        # FastAPI and aiortc come with an extra; video alone does without.
        from follower.cockpit.server import CockpitServer

        server = CockpitServer(begin, studio, wire.send)
        receiver.listeners.append(server.take)
        studio.on_picture = server.show
        await server.start()
    await asyncio.to_thread(receiver.run)
    if rtsp is not None:
        await rtsp.close()
    os._exit(0)  # what still waits for the network need not be waited for


async def _rtsp(video: VideoSettings, studio: Studio, wire: Wire) -> RtspServer | None:
    if video.rtsp is None:
        return None
    server = RtspServer(studio.ground, Address.parse(video.rtsp))
    try:
        await server.start()
    except OSError as error:
        words = f"No RTSP: {video.rtsp}: {error.strerror or error}"
        _say(wire, f"{words}; give video.rtsp an address of this computer and a free port")
        return None
    host = Address.parse(video.rtsp).host
    _say(wire, f"Video: rtsp://{host}:{server.port}/live")
    return server


def _say(wire: Wire, text: str) -> None:
    wire.send({"kind": "said", "text": text})


class _Receiver:
    """Takes the flight's messages on a thread until it hangs up."""

    def __init__(self, wire: Wire, image: SharedImage, studio: Studio) -> None:
        self._wire = wire
        self._image = image
        self._studio = studio
        self.listeners: list[Any] = []

    def run(self) -> None:
        self._wire.send({"kind": "ready"})
        try:
            while True:
                self._take(self._wire.receive())
        except (OSError, EOFError):
            return  # the flight is over

    def _take(self, message: Message) -> None:
        if message["kind"] != "picture":
            for listener in self.listeners:
                listener(message)
            return
        image = self._image.read(message["height"], message["width"])
        self._studio.take(message, image, lambda: self._wire.send({"kind": "ready"}))


if __name__ == "__main__":
    main()
