"""The interface of frame sources: where images come from."""

from types import TracebackType
from typing import Protocol, Self

from follower_vision.clock import Clock
from follower_vision.images.frame import Frame


class SourceError(ValueError):
    """A source gives no frames; the message says in one line what, where and what to do.

    Examples:
        >>> import follower
        >>> try:
        ...     follower.frames("gone.mp4")
        ... except follower.SourceError as error:
        ...     print(error)
        gone.mp4: there is no such file; check the path
    """


class FrameSource(Protocol):
    """Gives frames one after the other; also a context manager that closes itself."""

    @property
    def nominal_rate_hz(self) -> float:
        """Frames a second as the source declares them; measure intervals, do not trust this."""
        ...

    @property
    def frame_count(self) -> int | None:
        """How many frames there are, as the source declares it; None if unknown."""
        ...

    @property
    def problem(self) -> str | None:
        """What went wrong so far, in one line, e.g. why a file ended early; None if nothing."""
        ...

    def read(self) -> Frame | None:
        """Return the next frame (a live source: the newest), or None at the end."""
        ...

    def close(self) -> None:
        """Release what the source holds; afterwards `read` returns None."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class ClosesItself:
    """Makes a context manager of a class that has `close`."""

    def close(self) -> None:
        """Release what the source holds."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class RealtimePlayback(ClosesItself):
    """Gives a recording's frames as a camera would: each at its time, the newest only.

    The first frame is due at once. A reader that is late misses frames, which shows as gaps in
    the sequence numbers. `captured_s` is on `clock`. Closing it closes the recording.

    Attributes:
        nominal_rate_hz: of the recording.
        frame_count: of the recording; fewer may be given.
        skipped: how many frames were passed over because the reader was late.
    """

    def __init__(self, recording: FrameSource, clock: Clock) -> None:
        self._recording = recording
        self.nominal_rate_hz = recording.nominal_rate_hz
        self.frame_count = recording.frame_count
        self._clock = clock
        self._ahead: Frame | None = recording.read()
        self._offset_s: float | None = None
        self.skipped = 0

    @property
    def problem(self) -> str | None:
        """What is wrong with the recording."""
        return self._recording.problem

    def read(self) -> Frame | None:
        """Return the newest frame that is due, or wait for the next; None at the end."""
        frame = self._ahead
        if frame is None:
            return None
        if self._offset_s is None:
            self._offset_s = self._clock.now() - frame.captured_s
        self._ahead = self._recording.read()
        while self._ahead is not None and self._due_s(self._ahead) <= self._clock.now():
            frame, self._ahead = self._ahead, self._recording.read()
            self.skipped += 1
        due_s = self._due_s(frame)
        self._clock.sleep_until(due_s)
        return Frame(frame.image, due_s, frame.sequence)

    def close(self) -> None:
        """Close the recording."""
        self._ahead = None
        self._recording.close()

    def _due_s(self, frame: Frame) -> float:
        return frame.captured_s + (self._offset_s or 0.0)
