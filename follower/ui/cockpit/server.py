"""Runs the cockpit in the station's process."""

import asyncio
import contextlib
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import uvicorn
from pydantic import TypeAdapter

from follower.settings.ui import CockpitSettings
from follower.ui.cockpit.app import make_app
from follower.ui.cockpit.asgi_guard import (
    ConnectionLimiter,
    crowded_protocol,
)
from follower.ui.cockpit.auth import AccessControl
from follower.ui.cockpit.detections import Objects, box_shares
from follower.ui.cockpit.hub import Hub
from follower.ui.cockpit.mjpeg import JpegStream
from follower.ui.cockpit.recordings_api import RecordingFolder
from follower.ui.cockpit.video_pipeline import VideoPipeline
from follower.ui.cockpit.webrtc import WebRtcPeers
from follower.ui.ipc.messages import Message
from follower.ui.video.channel import SEND_BUFFER_BYTES, Picture
from follower_vision.clock import MonotonicClock
from follower_vision.detection import make_detector
from follower_vision.images.frame import Frame
from follower_vision.models import ModelStore, default_folder

_MOST_MESSAGE_BYTES = 4096
_MOST_CONNECTIONS, _MOST_OF_ONE_ADDRESS = 300, 60
_FIRST_REQUEST_S = 10.0
_PING_S = 5.0


class CockpitServer:
    """The page and what is behind it.

    Args:
        begin: the flight's first message; see `follower.ui.cockpit.process`.
        studio: has the pictures.
        send: takes what goes to the flight; from any thread.
    """

    def __init__(
        self, begin: Message, studio: VideoPipeline, send: Callable[[Message], None]
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._settings = TypeAdapter(CockpitSettings).validate_python(begin["cockpit"])
        self._token: str | None = begin.get("token")
        self._studio = studio
        self._send = send
        self._clock = MonotonicClock()
        self._jpegs = JpegStream(self._loop)
        self._hub = Hub(begin["page"], send, self._clock, self._settings.most_clients)
        objects = None
        if begin.get("detector"):
            objects = Objects(
                lambda: make_detector(begin["detector"], ModelStore(default_folder())),
                self._newest_frame,
                lambda found: self._call(lambda: self._hub.tell("objects", objects=found)),
                self._say,
                self._clock,
            )
        self._app = make_app(
            hub=self._hub,
            access=AccessControl(self._token, self._settings.names),
            jpegs=self._jpegs,
            peers=WebRtcPeers(studio.page, self._settings.on_loopback),
            flights=RecordingFolder(Path(begin["runs"])),
            objects=objects,
            clock=self._clock,
            secure=self._settings.scheme == "https",
        )
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Begin to serve, and say where; if the address is taken, say that."""
        try:
            listener = self._listener()
        except OSError as error:
            where = f"{self._settings.host}:{self._settings.port}"
            self._say(f"No cockpit: {where}: {error.strerror}; try --set cockpit.port=0")
            return
        task = asyncio.create_task(self._server().serve([listener]))
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        if not self._settings.on_loopback and self._settings.scheme == "http":
            self._say("The cockpit is not encrypted; see cockpit.tls_cert")
        self._say(f"Cockpit: {self._address(listener.getsockname()[1])}")

    def _ended(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._say(f"The cockpit ended: {error}")

    def take(self, message: Message) -> None:
        """Take a message from the flight, on the wire's thread."""
        self._call(lambda: self._hub.take(message))

    def show(self, picture: Picture) -> None:
        """Take a picture, on the studio's thread."""
        self._jpegs.show(picture)
        content = _track_content(picture)
        self._call(lambda: self._hub.tell("track", **content))

    def _call(self, what: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop was closed meanwhile
            self._loop.call_soon_threadsafe(what)

    def _listener(self) -> socket.socket:
        host, port = self._settings.host, self._settings.port
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.create_server((host, port), family=family, backlog=128)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        return listener

    def _server(self) -> uvicorn.Server:
        # On loopback there is only one address.
        most_each = _MOST_CONNECTIONS if self._settings.on_loopback else _MOST_OF_ONE_ADDRESS
        config = uvicorn.Config(
            self._app,
            ws="websockets-sansio",
            ws_max_size=_MOST_MESSAGE_BYTES,
            ws_ping_interval=_PING_S,
            ws_per_message_deflate=False,
            http=crowded_protocol(ConnectionLimiter(most_each), _FIRST_REQUEST_S),
            limit_concurrency=_MOST_CONNECTIONS,
            proxy_headers=False,
            timeout_graceful_shutdown=1,
            log_config=None,
            access_log=False,
            server_header=False,
            ssl_certfile=self._settings.tls_cert,
            ssl_keyfile=self._settings.tls_key,
        )
        return _Server(config)

    def _address(self, port: int) -> str:
        host = self._settings.host
        shown = f"[{host}]" if ":" in host else host
        secret = "" if self._token is None else f"/#{quote(self._token, safe='')}"
        return f"{self._settings.scheme}://{shown}:{port}{secret}"

    def _say(self, text: str) -> None:
        self._send({"kind": "said", "text": text})

    def _newest_frame(self) -> Frame | None:
        newest = self._studio.newest
        return None if newest is None else Frame(newest.image, newest.captured_s, newest.sequence)


class _Server(uvicorn.Server):
    """Leaves signals to the flight."""

    @contextlib.contextmanager
    def capture_signals(self) -> Any:
        yield


def _track_content(picture: Picture) -> dict[str, Any]:
    height, width = picture.image.shape[:2]
    tracks = [
        {
            "box": [round(share, 5) for share in box_shares(track.box, width, height)],
            "state": str(track.state),
            "confidence": round(track.confidence, 3),
            "by": track.produced_by,
        }
        for track in picture.tracks
    ]
    sequence, captured_s = picture.sequence, picture.captured_s
    return {"size": [width, height], "frame": sequence, "time_s": captured_s, "tracks": tracks}
