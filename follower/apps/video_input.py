"""The source of images that a command line names: a camera, a stream or a recording."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from follower.flight.log import FlightLog
from follower.settings.settings import CameraSettings
from follower.ui.terminal.console import counted
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import Clock
from follower_vision.images.frame import Frame
from follower_vision.sources.capture import CaptureSettings, without_password
from follower_vision.sources.frame_source import (
    ClosesItself,
    FrameSource,
    RealtimePlayback,
    SourceError,
)
from follower_vision.sources.open import is_live, open_source


@dataclass(frozen=True, slots=True)
class VideoInput:
    """A source of images as a user names it.

    Attributes:
        name: a device, an address, a pipeline, a file or a folder.
        realtime: a recording is played at its own pace.
        rate_hz: frames a second of a folder of images.
        capture: what a camera is asked for.

    Raises:
        SettingsError: there is no name.
    """

    name: str
    realtime: bool = False
    rate_hz: float = 30.0
    capture: CaptureSettings = field(default_factory=CaptureSettings)

    @classmethod
    def camera(cls, name: str | None, settings: CameraSettings) -> VideoInput:
        """Return what a command names, or the settings' source; a recording at its own pace."""
        return cls(name or settings.source or "", realtime=True, capture=settings.capture)

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise SettingsError(
                "which source? give a camera (0), a video file, a folder or a stream's address, or "
                "set camera.source"
            )

    @property
    def is_live(self) -> bool:
        """Whether it is a camera or a stream."""
        return is_live(self.name)

    @property
    def in_real_time(self) -> bool:
        """Whether frames come by the clock, and only the newest counts."""
        return self.realtime or self.is_live

    @property
    def shown(self) -> str:
        """The name without a password."""
        return without_password(self.name)

    @property
    def short_name(self) -> str:
        """A name for a run's folder."""
        if self.is_live:
            shown = self.shown.removeprefix("/dev/")
            return re.sub(r"[^A-Za-z0-9]+", "-", shown).strip("-")[:40]
        path = Path(self.name).resolve()
        name = path.parent.name if path.name == "img" else path.stem
        return re.sub(r"[^\w-]", "-", name)

    def open(self, clock: Clock | None = None) -> FrameSource:
        """Open it; frames of a camera are stamped by the clock.

        Raises:
            SourceError: nothing can be read there; the message says why and what to do.
        """
        source = open_source(
            self.name, folder_rate_hz=self.rate_hz, clock=clock, capture=self.capture
        )
        if clock is None or self.is_live or not self.realtime:
            return source
        return RealtimePlayback(source, clock)

    def open_or_dead(self, clock: Clock) -> FrameSource:
        """Open it; what cannot be opened is a camera without frames."""
        try:
            return self.open(clock)
        except SourceError as error:
            return DeadCamera(str(error))

    def restarted(self, source: FrameSource, clock: Clock) -> FrameSource:
        """Return the same open camera, or a recording from its beginning."""
        if self.is_live:
            return source
        source.close()
        return self.open(clock)


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


class UntilResized:
    """The frames of a source up to where their size changes.

    Attributes:
        resized: says where it changes, None as long as it does not.
    """

    def __init__(self, source: FrameSource) -> None:
        self._source = source
        self._size: tuple[int, int] | None = None
        self.resized: str | None = None

    @property
    def problem(self) -> str | None:
        """What ended the frames early or is wrong with the source; None if nothing."""
        return self.resized or self._source.problem

    def read(self) -> Frame | None:
        """Return the next frame, None at the end."""
        frame = None if self.resized else self._source.read()
        if frame is None:
            return None
        size = frame.width, frame.height
        if self._size not in (None, size):
            self.resized = (
                f"frame {frame.sequence} is {size[0]}x{size[1]} pixels, the ones before were not: "
                "the run ends there"
            )
            return None
        self._size = size
        return frame


def gaps_said(log: FlightLog) -> list[str]:
    """Return in a sentence where a recording's frames are far apart; nothing, usually."""
    gaps = [event for event in log.events if event.source == "video"]
    if not gaps:
        return []
    also = f", and {counted(len(gaps) - 1, 'more gap')}" if len(gaps) > 1 else ""
    return [f"At {gaps[0].time_s:.1f} s {gaps[0].text}{also}"]


_ROS_1 = b"#ROSBAG V2.0"


def is_bag(path: Path) -> bool:
    """Whether it is a rosbag2's folder, or ROS 1's .bag."""
    if (path / "metadata.yaml").is_file():
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_ROS_1)) == _ROS_1
