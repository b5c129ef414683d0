"""Plays a recorded source in real time."""

from __future__ import annotations

from follower_vision.clock import Clock
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself, FrameSource


class Paced(ClosesItself):
    """Gives a recording's frames as a camera would: each at its time, the newest only.

    The first frame is due at once. A reader that is late misses frames, which shows as gaps in
    the sequence numbers. `captured_s` is on `clock`. Closing it closes the recording.
    """

    def __init__(self, recording: FrameSource, clock: Clock) -> None:
        self._recording = recording
        self._clock = clock
        self._ahead: Frame | None = recording.read()
        self._offset_s: float | None = None
        self._skipped = 0

    @property
    def nominal_rate_hz(self) -> float:
        """The recording's rate."""
        return self._recording.nominal_rate_hz

    @property
    def frame_count(self) -> int | None:
        """How many frames the recording has; fewer may be given."""
        return self._recording.frame_count

    @property
    def problem(self) -> str | None:
        """What is wrong with the recording."""
        return self._recording.problem

    @property
    def skipped(self) -> int:
        """How many frames were passed over because the reader was late."""
        return self._skipped

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
            self._skipped += 1
        due_s = self._due_s(frame)
        self._clock.sleep_until(due_s)
        return Frame(frame.image, due_s, frame.sequence)

    def close(self) -> None:
        """Close the recording."""
        self._ahead = None
        self._recording.close()

    def _due_s(self, frame: Frame) -> float:
        return frame.captured_s + (self._offset_s or 0.0)
