"""The station's process: `python -m follower.ui.cockpit.process WIRE IMAGE`, started by `Station`.

The first message is `begin`:

| key       | value                                                           |
|-----------|-----------------------------------------------------------------|
| `video`   | settings of the video that goes out                             |
| `cockpit` | settings of the page, or nothing without one                    |
| `page`    | what the page is to know from the start: mode, settings, title  |
| `runs`    | folder with the flights                                         |
| `detector`| name of the detector that numbers what may be tapped, or nothing|
"""

import asyncio
import logging
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection

import cv2
from pydantic import TypeAdapter

from follower.settings.ui import Address, VideoSettings
from follower.ui.cockpit.video_pipeline import VideoPipeline
from follower.ui.ipc.messages import FROM_FLIGHT_BYTES, Message, Wire, WireError
from follower.ui.ipc.server_client import SharedImage
from follower.ui.video.rtsp_server import RtspServer

_POLITENESS = 5
"""The flight's threads come first where cores are few."""


def main() -> None:
    """Serve until the flight hangs up."""
    _give_way()
    cv2.setNumThreads(1)
    # Libraries warn of whatever strangers send; only what ends the process is ever read.
    logging.getLogger().addHandler(logging.NullHandler())
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
    studio = VideoPipeline(video)
    rtsp = await _rtsp(video, studio, wire)
    studio.start_senders(lambda text: _say(wire, text))
    take: Callable[[Message], None] | None = None
    if begin.get("cockpit") is not None:
        # FastAPI and aiortc come with an extra; video alone does without.
        from follower.ui.cockpit.server import CockpitServer

        server = CockpitServer(begin, studio, wire.send)
        take = server.take
        studio.on_picture = server.show
        await server.start()
    await asyncio.to_thread(_receive, wire, image, studio, take)
    if rtsp is not None:
        await rtsp.close()
    os._exit(0)  # what still waits for the network need not be waited for


async def _rtsp(video: VideoSettings, studio: VideoPipeline, wire: Wire) -> RtspServer | None:
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


def _receive(
    wire: Wire, image: SharedImage, studio: VideoPipeline, take: Callable[[Message], None] | None
) -> None:
    """Take the flight's messages until it hangs up."""

    def ready() -> None:
        wire.send({"kind": "ready"})

    with suppress(OSError, EOFError):  # the flight is over
        ready()
        while True:
            message = wire.receive()
            if message["kind"] == "picture":
                pixels = image.read(message["height"], message["width"])
                studio.take(message, pixels, ready)
            elif take is not None:
                take(message)


if __name__ == "__main__":
    main()
