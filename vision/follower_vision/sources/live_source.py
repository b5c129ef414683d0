"""Frames from a live camera or stream: always the newest one."""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass

from follower_vision.clock import Clock
from follower_vision.images.frame import Frame
from follower_vision.mailbox import Mailbox
from follower_vision.sources.camera_connection import Connection
from follower_vision.sources.frame_source import ClosesItself, SourceError

_FALLBACK_RATE_HZ = 30.0
_JOIN_S = 3.0


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """How a live source behaves.

    Attributes:
        first_frame_s: how long to wait for the very first frame before giving up.
        retry_s: the pause before the first attempt to reconnect; it doubles with each.
        longest_retry_s: the longest pause.
    """

    first_frame_s: float = 10.0
    retry_s: float = 0.2
    longest_retry_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0 < self.retry_s <= self.longest_retry_s < math.inf:
            raise ValueError("live source: 0 < retry_s <= longest_retry_s has to hold")
        if not self.first_frame_s > 0:
            raise ValueError("live source: first_frame_s has to be positive")


class LiveSource(ClosesItself):
    """Reads a connection in a thread of its own and keeps the newest frame.

    `read` waits for a frame that it has not given yet; frames that were not read in time are
    passed over, which shows as gaps in the sequence numbers. When the connection breaks it is
    made anew, with growing pauses, for as long as the source is open.

    Args:
        connect: makes a connection; raises SourceError where it cannot.
        clock: gives the capture times.
        settings: see there.

    Attributes:
        problem: what keeps frames from coming at present, in one line; None while they come.
        connections: how many times a connection was made.
        frame_count: None, for a live source has no end.
    """

    frame_count: int | None = None

    def __init__(
        self,
        connect: Callable[[], Connection],
        clock: Clock,
        settings: LiveSettings | None = None,
    ) -> None:
        self._connect = connect
        self._clock = clock
        self._settings = settings or LiveSettings()
        self._mailbox: Mailbox[Frame] = Mailbox()
        self._stop = threading.Event()
        self.problem: str | None = None
        self._rate_hz: float | None = None
        self._sequence = 0
        self.connections = 0
        self._first: Frame | None = None
        self._thread = threading.Thread(target=self._run, name="live-source", daemon=True)
        self._thread.start()

    @property
    def nominal_rate_hz(self) -> float:
        """The rate that the other side declares, 30 if it does not."""
        return self._rate_hz or _FALLBACK_RATE_HZ

    @property
    def skipped(self) -> int:
        """How many frames were passed over because newer ones came before they were read."""
        return self._mailbox.overwritten

    def wait_for_first(self) -> None:
        """Return once the first frame is there.

        Raises:
            SourceError: none came within `first_frame_s`; the source is closed then.
        """
        self._first = self._mailbox.wait(self._settings.first_frame_s)
        if self._first is None:
            problem = self.problem or "no frame came in time; is the camera sending?"
            self.close()
            raise SourceError(problem)

    def read(self) -> Frame | None:
        """Return the newest frame not read yet, waiting for it; None once closed."""
        if self._first is not None:
            first, self._first = self._first, None
            return self._mailbox.wait(0) or first
        return self._mailbox.wait()

    def close(self) -> None:
        """Stop reading; a thread in `read` gets None."""
        self._stop.set()
        self._mailbox.close()
        if self._thread is not threading.current_thread():
            self._thread.join(_JOIN_S)

    def _run(self) -> None:
        """Connect, read until it breaks, wait a little longer each time, connect again."""
        pause_s = self._settings.retry_s
        while not self._stop.is_set():
            before = self._sequence
            try:
                self._read_one()
                self.problem = "the stream ended; connecting again"
            except SourceError as error:
                self.problem = str(error)
            except Exception as error:  # of a decoder's library, perhaps: the camera may come again
                self.problem = f"{type(error).__name__}: {error}"
            if self._sequence > before:
                pause_s = self._settings.retry_s
            self._stop.wait(pause_s)
            pause_s = min(2 * pause_s, self._settings.longest_retry_s)

    def _read_one(self) -> None:
        """Read one connection to its end."""
        connection = self._connect()
        self.connections += 1
        self._rate_hz = connection.rate_hz
        try:
            for image, arrival_s in connection.images():
                if self._stop.is_set():
                    return
                self.problem = None
                self._mailbox.put(Frame(image, arrival_s, self._sequence))
                self._sequence += 1
        finally:
            connection.close()
