"""What waits to be sent to the station: the newest picture and moment, and a few words."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from follower.station.wire import Message
from follower.video_out.picture import Picture

_MOST_WORDS = 200


@dataclass(frozen=True, slots=True)
class Parcel:
    """What is to be sent now."""

    messages: tuple[Message, ...]
    picture: Picture | None


class Outbox:
    """Filled by the flight's threads without waiting, emptied by the sender's."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._words: deque[Message] = deque(maxlen=_MOST_WORDS)
        self._state: Message | None = None
        self._picture: Picture | None = None
        self._picture_wanted = False
        self._closed = False

    def tell(self, message: Message) -> None:
        """Send this; beyond 200 that wait, the oldest is left out."""
        with self._condition:
            self._words.append(message)
            self._condition.notify()

    def state(self, message: Message) -> None:
        """Send this in place of an older one."""
        with self._condition:
            self._state = message
            self._condition.notify()

    def show(self, picture: Picture) -> None:
        """Send this in place of an older one, as soon as a picture is wanted."""
        with self._condition:
            self._picture = picture
            if self._picture_wanted:
                self._condition.notify()

    def picture_wanted(self) -> None:
        """Note that the last picture was taken."""
        with self._condition:
            self._picture_wanted = True
            self._condition.notify()

    def close(self) -> None:
        """Let the sender go."""
        with self._condition:
            self._closed = True
            self._condition.notify()

    def wait(self) -> Parcel | None:
        """Wait for something to send; None after `close`."""
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._has_something)
            if self._closed:
                return None
            messages = [*self._words, *([] if self._state is None else [self._state])]
            self._words.clear()
            self._state = None
            picture = None
            if self._picture_wanted and self._picture is not None:
                picture, self._picture = self._picture, None
                self._picture_wanted = False
            return Parcel(tuple(messages), picture)

    @property
    def _has_something(self) -> bool:
        has_picture = self._picture_wanted and self._picture is not None
        return bool(self._words) or self._state is not None or has_picture
