"""Opens the camera of a flight. A recording plays on as a camera would, and can be begun anew."""

from __future__ import annotations

from follower.fly.options import FlyOptions
from follower_vision.clock import Clock
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself, FrameSource, SourceError
from follower_vision.paced import Paced
from follower_vision.sources import is_live, open_source


def open_camera(options: FlyOptions, clock: Clock) -> FrameSource:
    """Open what `--camera` names.

    Raises:
        SourceError: nothing can be read there; the message says why and what to do.
    """
    source = open_source(options.camera, folder_rate_hz=options.rate_hz, clock=clock)
    return source if is_live(options.camera) else Paced(source, clock)


def open_camera_or_dead(options: FlyOptions, clock: Clock) -> FrameSource:
    """Open what `--camera` names; what cannot be opened is a camera without frames."""
    try:
        return open_camera(options, clock)
    except SourceError as error:
        return DeadCamera(str(error))


def after_preflight(source: FrameSource, options: FlyOptions, clock: Clock) -> FrameSource:
    """Return the camera to fly with: the same one, or a recording from its beginning."""
    if is_live(options.camera):
        return source
    source.close()
    return open_camera(options, clock)


class DeadCamera(ClosesItself):
    """A camera that gives no frames, and says why."""

    def __init__(self, problem: str) -> None:
        self.problem: str | None = problem
        self.nominal_rate_hz = 0.0
        self.frame_count: int | None = None

    def read(self) -> Frame | None:
        """Return None: there are no frames."""
        return None

    def close(self) -> None:
        """Nothing is held."""


class SteadySource(ClosesItself):
    """A camera whose frames keep the size of the first ones; others are left out.

    Args:
        source: closed with this.
        size: width and height.

    Attributes:
        ended: there will be no more frames.
        problem: why frames are missing at present, None if they are not.
    """

    def __init__(self, source: FrameSource, size: tuple[int, int]) -> None:
        self._source = source
        self._size = size
        self._wrong: str | None = None
        self.ended = False

    @property
    def nominal_rate_hz(self) -> float:
        """The camera's rate."""
        return self._source.nominal_rate_hz

    @property
    def frame_count(self) -> int | None:
        """How many frames a recording has."""
        return self._source.frame_count

    @property
    def problem(self) -> str | None:
        """What keeps frames from coming at present."""
        return self._wrong or self._source.problem

    def read(self) -> Frame | None:
        """Return the next frame of the right size, None at the end."""
        while (frame := self._source.read()) is not None:
            if (frame.width, frame.height) == self._size:
                self._wrong = None
                return frame
            width, height = self._size
            self._wrong = f"frames are {frame.width}x{frame.height} now, not {width}x{height}"
        self.ended = True
        return None

    def close(self) -> None:
        """Close the camera."""
        self._source.close()
