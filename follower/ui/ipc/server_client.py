"""The flight's end of the UI process: sends pictures and state, receives operators' requests."""

import contextlib
import mmap
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import Pipe
from typing import Protocol

import numpy as np

from follower.ui.ipc.messages import (
    FROM_STATION_BYTES,
    TRACKS,
    Message,
    Wire,
    WireError,
)
from follower.ui.video.channel import Picture
from follower_vision.images.frame import Frame, Image
from follower_vision.sources.frame_source import ClosesItself
from follower_vision.trackers.track import Track

_MOST_BYTES = 100_000_000
_MOST_QUEUED = 200
_EXIT_S = 3.0


class SharedImage:
    """One slot: the writer waits with the next image until the reader has copied this one.

    Args:
        descriptor: of the memory; both processes have it.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._map: mmap.mmap | None = None
        self._bytes = 0

    def write(self, image: Image) -> None:
        """Put an image, (H, W, 3) uint8 BGR, into the slot."""
        if image.nbytes > self._bytes:
            os.ftruncate(self.descriptor, image.nbytes)
        np.copyto(self._view(image.shape[0], image.shape[1]), image)

    def read(self, height: int, width: int) -> Image:
        """Return a copy of the image, (height, width, 3) uint8 BGR.

        Raises:
            ValueError: there is no image of that size.
        """
        return self._view(height, width).copy()

    def close(self) -> None:
        """Give the memory back."""
        self._map = None
        os.close(self.descriptor)

    def _view(self, height: int, width: int) -> Image:
        length = height * width * 3
        if not 0 < length <= _MOST_BYTES:
            raise ValueError(f"no image has {width}x{height} pixels")
        if self._map is None or length > self._bytes:
            if os.fstat(self.descriptor).st_size < length:
                raise ValueError("there is no image yet")
            self._map = mmap.mmap(self.descriptor, length)
            self._bytes = length
        return np.frombuffer(self._map, np.uint8, length).reshape(height, width, 3)


class Outbox:
    """Filled by the flight's threads without waiting, emptied by the sender's."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._queue: deque[Message] = deque(maxlen=_MOST_QUEUED)
        self._state: Message | None = None
        self._picture: Picture | None = None
        self._picture_wanted = False
        self._closed = False

    def tell(self, message: Message) -> None:
        """Send this; beyond 200 that wait, the oldest is left out."""
        with self._condition:
            self._queue.append(message)
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

    def wait(self) -> tuple[list[Message], Picture | None] | None:
        """Wait for messages to send, and a picture if one is wanted; None after `close`."""
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._has_something)
            if self._closed:
                return None
            messages = [*self._queue, *([] if self._state is None else [self._state])]
            self._queue.clear()
            self._state = picture = None
            if self._picture_wanted and self._picture is not None:
                picture, self._picture = self._picture, None
                self._picture_wanted = False
            return messages, picture

    @property
    def _has_something(self) -> bool:
        has_picture = self._picture_wanted and self._picture is not None
        return bool(self._queue) or self._state is not None or has_picture


class Operator(Protocol):
    """Carries out what operators ask for."""

    def ask(self, request: Message, by: str) -> Message | None:
        """Return the answer, None if it comes later by `late_answers`."""
        ...

    def late_answers(self) -> Sequence[Message]:
        """Return the answers that have become known."""
        ...

    def heard(self) -> None:
        """Take note that the operator in control is there."""
        ...


class UiProcessClient(ClosesItself):
    """A child process that offers video and the cockpit; the flight never waits for it.

    It is a `FlightVideo`. However the child ends, the flight goes on, and `remark` says so.

    Args:
        begin: what to offer; see `follower.ui.cockpit.process`.
        say: is shown each line that the child has for the user, on a thread of ours.

    Attributes:
        operator: carries out requests; None refuses them.
    """

    def __init__(self, begin: Message, say: Callable[[str], None]) -> None:
        self.operator: Operator | None = None
        self.remark: str | None = None
        self._lines: queue.Queue[str | None] = queue.Queue(_MOST_QUEUED)
        self._closing = False
        self._outbox = Outbox()
        self._image = SharedImage(os.memfd_create("follower-image"))
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed by `close`
        self._process, self._wire = self._launch()
        self._threads = [
            threading.Thread(target=loop, name=f"station {name}", daemon=True)
            for name, loop in (
                ("sender", self._send_all),
                ("receiver", self._receive_all),
                ("lines", partial(self._say_all, say)),
            )
        ]
        self._outbox.tell({"kind": "begin", **begin})
        for thread in self._threads:
            thread.start()

    def add(self, frame: Frame, tracks: Sequence[Track], lines: Sequence[str]) -> None:
        """Show a frame that vision answered for; if the child is busy, the newest one later."""
        image, captured_s = frame.image, frame.captured_s
        picture = Picture(image, frame.sequence, captured_s, tuple(tracks), tuple(lines))
        self._outbox.show(picture)

    def show(self, state: Message) -> None:
        """Show the flight's present state; an older one that was not sent yet is left out."""
        self._outbox.state({"kind": "state", "state": state})

    def tell_page(self, news: Message) -> None:
        """Tell the page something that lasts, now and to whoever comes later."""
        self._outbox.tell({"kind": "page", "page": news})

    @property
    def process_id(self) -> int:
        """Of the child."""
        return self._process.pid

    def close(self) -> None:
        """End the child."""
        if self._closing:
            return
        self._closing = True
        self._outbox.close()
        self._wire.hang_up()
        try:
            self._process.wait(_EXIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        *others, lines = self._threads
        for thread in others:
            thread.join(_EXIT_S)
        self._say(None)
        lines.join(_EXIT_S)
        self._wire.close()
        self._image.close()
        self._errors.close()

    def _launch(self) -> tuple[subprocess.Popen[bytes], Wire]:
        ours, theirs = Pipe()
        descriptors = (theirs.fileno(), self._image.descriptor)
        command = [sys.executable, "-m", "follower.ui.cockpit.process", *map(str, descriptors)]
        process = subprocess.Popen(  # noqa: S603  our own program
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            pass_fds=descriptors,
            start_new_session=True,  # Ctrl-C is for the flight, which then ends its station
        )
        theirs.close()
        return process, Wire(ours, FROM_STATION_BYTES)

    def _say(self, line: str | None) -> None:
        """Have a line said; one too many is left out. None is the last one."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(line)

    def _say_all(self, say: Callable[[str], None]) -> None:
        """Say the lines on a thread of its own: a terminal that hangs must not hold up a stop."""
        while (line := self._lines.get()) is not None:
            say(line)

    def _send_all(self) -> None:
        try:
            with contextlib.suppress(OSError):  # the receiver notices and says so
                while (waiting := self._outbox.wait()) is not None:
                    self._send_waiting(*waiting)
        finally:  # whatever ended it: a page that receives nothing is not to go on
            self._wire.hang_up()

    def _send_waiting(self, messages: list[Message], picture: Picture | None) -> None:
        for message in (*messages, *self._late_answers()):
            self._send(message)
        if picture is not None:
            self._image.write(picture.image)
            self._send(_picture_message(picture))

    def _send(self, message: Message) -> None:
        """Send a message; what JSON cannot say is left out, but for the word that it was."""
        try:
            self._wire.send(message)
        except ValueError as error:
            self._say(f"Not sent to the UI process: {message['kind']}: {error}")
            if message["kind"] == "picture":
                self._outbox.picture_wanted()

    def _late_answers(self) -> Sequence[Message]:
        return () if self.operator is None else self.operator.late_answers()

    def _receive_all(self) -> None:
        why = "an error on our side"
        try:
            while True:
                self._take(self._wire.receive())
        except (OSError, EOFError):
            why = ""
        except WireError as error:
            why = str(error)
        finally:  # whatever ended it: a page whose requests are lost is not to go on
            if not self._closing:
                self._wire.hang_up()
                self.remark = f"The station ended during the flight: {why or self._last_error()}"
                self._say(self.remark)

    def _take(self, message: Message) -> None:
        match message["kind"]:
            case "ready":
                self._outbox.picture_wanted()
            case "heard" if self.operator is not None:
                self.operator.heard()
            case "request":
                self._ask(message)
            case "said":
                self._say(str(message.get("text", "")))

    def _ask(self, message: Message) -> None:
        number, request = message.get("number"), message.get("request")
        if not isinstance(number, int) or not isinstance(request, dict):
            raise WireError("no request: its number is missing")
        if self.operator is None:
            answer: Message | None = {"accepted": False, "text": "nothing flies yet"}
        else:
            answer = self.operator.ask({**request, "number": number}, str(message.get("by", "")))
        if answer is not None:
            self._outbox.tell({"kind": "answer", "number": number, **answer})

    def _last_error(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXIT_S)
        with contextlib.suppress(OSError, ValueError):
            self._errors.seek(0)
            lines = self._errors.read().decode("utf-8", "replace").strip().splitlines()
            return lines[-1] if lines else f"exit code {self._process.returncode}"
        return "no word of it"


def _picture_message(picture: Picture) -> Message:
    height, width = picture.image.shape[:2]
    return {
        "kind": "picture",
        "height": height,
        "width": width,
        "sequence": picture.sequence,
        "captured_s": picture.captured_s,
        "tracks": TRACKS.dump_python(picture.tracks, mode="json"),
        "lines": list(picture.lines),
    }
