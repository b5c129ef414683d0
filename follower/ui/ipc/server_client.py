"""The flight's end of its station: shows it pictures and moments, and hears its operators."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

from follower.station.outbox import Outbox, Parcel
from follower.station.shared_image import SharedImage
from follower.station.wire import (
    FROM_STATION_BYTES,
    Message,
    Wire,
    WireError,
    socket_pair,
    track_message,
)
from follower.video_out.picture import Picture
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself
from follower_vision.track import Track

_FAREWELL_S = 3.0


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


class Station(ClosesItself):
    """A child process that offers video and the cockpit; the flight never waits for it.

    It is a `FlightVideo`. However the child ends, the flight goes on, and `remark` says so.

    Args:
        begin: what to offer; see `follower.station.child`.
        say: is shown each line that the child has for the user, on a thread of ours.
        operator: carries out requests; None refuses them. May be set later.
    """

    def __init__(
        self, begin: Message, say: Callable[[str], None], operator: Operator | None = None
    ) -> None:
        self.operator = operator
        self.remark: str | None = None
        self._say = say
        self._closing = False
        self._started = threading.Event()
        self._outbox = Outbox()
        self._image = SharedImage.make()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  closed by `close`
        self._process, self._wire = self._launch()
        self._threads = [
            threading.Thread(target=loop, name=f"station {name}", daemon=True)
            for name, loop in (("sender", self._send_all), ("receiver", self._receive_all))
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
        """Show a moment of the flight; an older one that was not sent yet is left out."""
        self._outbox.state({"kind": "state", "state": state})

    def tell_page(self, news: Message) -> None:
        """Tell the page something that lasts, now and to whoever comes later."""
        self._outbox.tell({"kind": "page", "page": news})

    def wait_started(self, timeout_s: float) -> bool:
        """Wait until the child has said where it is; False if it has not in time."""
        return self._started.wait(timeout_s)

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
            self._process.wait(_FAREWELL_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join(_FAREWELL_S)
        self._wire.close()
        self._image.close()
        self._errors.close()

    def _launch(self) -> tuple[subprocess.Popen[bytes], Wire]:
        ours, theirs = socket_pair()
        descriptors = (theirs.fileno(), self._image.descriptor)
        command = [sys.executable, "-m", "follower.station.child", *map(str, descriptors)]
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

    def _send_all(self) -> None:
        try:
            with contextlib.suppress(OSError):  # the receiver notices and says so
                while (parcel := self._outbox.wait()) is not None:
                    self._send_parcel(parcel)
        finally:  # whatever ended it: a page that is told nothing is not to go on
            self._wire.hang_up()

    def _send_parcel(self, parcel: Parcel) -> None:
        for message in (*parcel.messages, *self._late_answers()):
            self._send(message)
        if parcel.picture is not None:
            self._image.write(parcel.picture.image)
            self._send(_picture_message(parcel.picture))

    def _send(self, message: Message) -> None:
        """Send a message; what JSON cannot say is left out, but for the word that it was."""
        try:
            self._wire.send(message)
        except ValueError as error:
            self._say(f"The station was not told of a {message['kind']}: {error}")
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
        finally:  # whatever ended it: a page that nobody hears is not to go on
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
                self._started.set()

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
            self._process.wait(_FAREWELL_S)
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
        "tracks": [track_message(track) for track in picture.tracks],
        "lines": list(picture.lines),
    }
