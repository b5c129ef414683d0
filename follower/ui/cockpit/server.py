"""Runs the cockpit in the station's process."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn
from pydantic import TypeAdapter

from follower.cockpit.access import Access
from follower.cockpit.app import Parts, make_app
from follower.cockpit.crowd import Crowd, crowded_protocol
from follower.cockpit.flights import Flights
from follower.cockpit.guard import Guard
from follower.cockpit.hub import Hub, Message
from follower.cockpit.limiters import Limiters
from follower.cockpit.mjpeg import JpegStream
from follower.cockpit.objects import Objects
from follower.cockpit.settings import CockpitSettings
from follower.cockpit.webrtc import Peers
from follower.station.studio import Studio
from follower.video_out.picture import Picture
from follower_vision.clock import MonotonicClock
from follower_vision.detection import Detector, make_detector
from follower_vision.frame import Frame
from follower_vision.models import ModelStore, default_folder

_MOST_MESSAGE_BYTES = 4096
_GUESSES_HZ, _GUESSES_BURST = 1.0, 8
_WRITES_HZ, _WRITES_BURST = 50.0, 100
_MOST_CONNECTIONS, _MOST_OF_ONE_ADDRESS = 300, 60
_FIRST_REQUEST_S = 10.0
_PING_S = 5.0


class CockpitServer:
    """The page and what is behind it.

    Args:
        begin: the flight's first message; see `follower.station.child`.
        studio: has the pictures.
        send: takes what goes to the flight; from any thread.
    """

    def __init__(self, begin: Message, studio: Studio, send: Callable[[Message], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._settings = TypeAdapter(CockpitSettings).validate_python(begin["cockpit"])
        self._token: str | None = begin.get("token")
        self._studio = studio
        self._send = send
        self._clock = MonotonicClock()
        self._hub = Hub(begin["page"], send, self._clock, self._settings.most_clients)
        self._jpegs = JpegStream(self._loop)
        objects = None
        if begin.get("detector"):
            make = _detector_maker(begin["detector"])
            objects = Objects(make, self._newest_frame, self._show_objects, self._say, self._clock)
        self._parts = Parts(
            hub=self._hub,
            access=Access(self._token, self._settings.names),
            jpegs=self._jpegs,
            peers=Peers(studio.page, self._settings.on_loopback),
            flights=Flights(Path(begin["runs"])),
            objects=objects,
            guesses=Limiters(_GUESSES_HZ, _GUESSES_BURST, self._clock),
            writes=Limiters(_WRITES_HZ, _WRITES_BURST, self._clock),
            clock=self._clock,
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
        return socket.create_server((host, port), family=family, backlog=128)

    def _server(self) -> uvicorn.Server:
        nonce = secrets.token_urlsafe(12)
        app = make_app(self._parts, nonce, self._settings.scheme == "https")
        parts = self._parts
        guard = Guard(app, parts.access, parts.guesses, parts.writes, nonce)
        config = uvicorn.Config(
            guard,
            ws="websockets-sansio",
            ws_max_size=_MOST_MESSAGE_BYTES,
            ws_ping_interval=_PING_S,
            ws_per_message_deflate=False,
            http=crowded_protocol(Crowd(self._most_each), _FIRST_REQUEST_S),
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

    @property
    def _most_each(self) -> int:
        """Connections of one address; on loopback there is only one."""
        return _MOST_CONNECTIONS if self._settings.on_loopback else _MOST_OF_ONE_ADDRESS

    def _address(self, port: int) -> str:
        host = self._settings.host
        shown = f"[{host}]" if ":" in host else host
        secret = "" if self._token is None else f"/#{self._token}"
        return f"{self._settings.scheme}://{shown}:{port}{secret}"

    def _say(self, text: str) -> None:
        self._send({"kind": "said", "text": text})

    def _newest_frame(self) -> Frame | None:
        newest = self._studio.newest
        return None if newest is None else Frame(newest.image, newest.captured_s, newest.sequence)

    def _show_objects(self, objects: list[dict[str, Any]]) -> None:
        self._call(lambda: self._hub.tell("objects", objects=objects))


class _Server(uvicorn.Server):
    """Leaves signals to the flight."""

    @contextlib.contextmanager
    def capture_signals(self) -> Any:
        yield


def _detector_maker(name: str) -> Callable[[], Detector]:
    return lambda: make_detector(name, ModelStore(default_folder(os.environ)))


def _track_content(picture: Picture) -> dict[str, Any]:
    height, width = picture.image.shape[:2]
    tracks = [
        {
            "box": [
                round(track.box.left / width, 5),
                round(track.box.top / height, 5),
                round(track.box.right / width, 5),
                round(track.box.bottom / height, 5),
            ],
            "state": str(track.state),
            "confidence": round(track.confidence, 3),
            "by": track.produced_by,
        }
        for track in picture.tracks
    ]
    sequence, captured_s = picture.sequence, picture.captured_s
    return {"size": [width, height], "frame": sequence, "time_s": captured_s, "tracks": tracks}
