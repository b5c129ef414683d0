"""Messages between the flight and the UI process: JSON, of bounded length.

| from the flight | says                                                     |
|-----------------|----------------------------------------------------------|
| `begin`         | what to offer: settings of video and cockpit, and so on  |
| `picture`       | an image lies in the slot; its size, time, tracks, lines |
| `state`         | the flight's newest state, for the page                   |
| `page`          | something that lasts, for the page                       |
| `answer`        | what came of a request                                   |

| from the process | says                                                    |
|------------------|---------------------------------------------------------|
| `ready`          | the slot was copied: the next picture may come          |
| `request`        | what an operator wants, with a number for the answer    |
| `heard`          | the operator in control is there                        |
| `said`           | a line to show: where the page is, or what went wrong   |
"""

import contextlib
import json
import os
import socket
import threading
from multiprocessing.connection import Connection
from typing import Any

from pydantic import TypeAdapter

from follower_vision.trackers.track import Track

Message = dict[str, Any]
TRACKS: TypeAdapter[tuple[Track, ...]] = TypeAdapter(tuple[Track, ...])
"""Tracks as plain values and back."""
FROM_FLIGHT_BYTES = 1 << 21
FROM_STATION_BYTES = 1 << 15


class WireError(ValueError):
    """The other side said something that is no message."""


class Wire:
    """One end of the line between the two processes; any thread may send, one receives.

    Args:
        connection: the end.
        most_bytes: that a message from the other side may have.
    """

    def __init__(self, connection: Connection, most_bytes: int) -> None:
        self._connection = connection
        self._most_bytes = most_bytes
        self._lock = threading.Lock()

    def send(self, message: Message) -> None:
        """Send; waits while the other side does not read.

        Raises:
            OSError: the other side is gone.
        """
        data = json.dumps(message, allow_nan=False).encode()
        with self._lock:
            self._connection.send_bytes(data)

    def receive(self) -> Message:
        """Wait for the next message.

        Raises:
            OSError, EOFError: the other side is gone, or sent more than it may.
            WireError: that was no message.
        """
        try:
            message = json.loads(self._connection.recv_bytes(self._most_bytes))
        except ValueError as error:
            raise WireError(f"no JSON: {error}") from None
        if not isinstance(message, dict) or not isinstance(message.get("kind"), str):
            raise WireError("no message: its kind is missing")
        return message

    def hang_up(self) -> None:
        """End every sending and receiving, also that which is waiting now."""
        with (
            contextlib.suppress(OSError),
            socket.socket(fileno=os.dup(self._connection.fileno())) as line,
        ):
            line.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Give the line back, once nobody uses it any more."""
        self._connection.close()
