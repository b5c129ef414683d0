"""Video in, tracks out."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from follower.apps.target_choice import TargetChoice
from follower.apps.video_input import VideoInput
from follower.flight.target.selectors import first_selected
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import (
    close_tracker,
    make_settings_detector,
    make_target_tracker,
)
from follower.settings.settings import load_settings
from follower_vision.clock import MonotonicClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself, FrameSource, SourceError
from follower_vision.trackers.track import Track

_COME_ALONG = {"tracker": "siamese-correlation", "detector": "embedded"}


def frames(
    source: str | int | Path, *, realtime: bool = False, rate_hz: float = 30.0
) -> Iterator[Frame]:
    """Open a camera, a stream or a recording at once, and give its frames.

    Args:
        source: a video file, a folder of images, a camera (`0`, "/dev/video0"), the address of a
            stream ("rtsp://…", "udp://…"), or "gst:" and a GStreamer pipeline.
        realtime: a recording is played at its own pace, and only the newest frame counts.
        rate_hz: frames a second of a folder of images.

    Yields:
        Frames in their order, `image` (H, W, 3) uint8 BGR, `captured_s` in seconds: since a
        recording's start, or on the monotonic clock.

    Raises:
        SourceError: nothing can be read there; or, after the last frame, why it ended early or
            that it is damaged.
        SettingsError: the source has no name.

    Examples:
        >>> import follower
        >>> for frame in follower.frames("clip.mp4"):
        ...     image = frame.image
        >>> frame.width, frame.height, frame.sequence
        (320, 240, 59)
    """
    video = VideoInput(str(source), realtime, rate_hz)
    return _given(video.open(MonotonicClock() if video.in_real_time else None))


def _given(source: FrameSource) -> Iterator[Frame]:
    with source:
        while (frame := source.read()) is not None:
            yield frame
        problem = source.problem
    if problem is not None:
        raise SourceError(problem)


class Fusion(ClosesItself):
    """Follows one target through video: a motion tracker and a detector, fused.

    The same stage as in a flight. Also a context manager that closes itself.

    Args:
        target: see `select`; None leaves that for later.
        device: where the networks run: "auto", "cpu", "cuda", "tensorrt", …; None leaves it to the
            settings, whose default is "auto".
        config: settings file; a tracker or detector that it does not name is the one that comes
            along ("siamese-correlation", "embedded").
        overrides: `key=value` each, as `--set` takes them: "detector=yolox-nano".

    Raises:
        SettingsError: a setting cannot be used, or the target's class or colour is unknown.
        ModelError: a network is missing or broken; the message says how to get it.

    Examples:
        >>> import follower
        >>> tracker = follower.Fusion("#d02020", device="auto")  # or a Box, or "car"
        >>> for frame in follower.frames("clip.mp4"):
        ...     track = tracker.step(frame)
        >>> print(track.state, round(track.box.cx, -1), "px")
        tracking 210.0 px
        >>> tracker.close()
    """

    def __init__(
        self,
        target: Box | str | None = None,
        *,
        device: str | None = None,
        config: str | Path | None = None,
        overrides: Iterable[str] = (),
    ) -> None:
        named = () if device is None else (f"vision.device={json.dumps(device)}",)
        settings = load_settings(config, _COME_ALONG, (*named, *overrides))
        self._settings = settings
        self._tracker = make_target_tracker(settings)
        self._stage = VisionStage(self._tracker)
        if target is not None:
            self.select(target)

    def select(self, target: Box | str) -> None:
        """Choose the target anew, in the coming frames, as soon as it is seen.

        Args:
            target: a box in pixels of the next frame; or an object that the detector knows:
                "car", "car:2" for the second from the image's centre; or a colour, "#rrggbb".

        Raises:
            SettingsError: the class or colour is unknown.
            ModelError: a class was given, and there is no detector.
        """
        choice = TargetChoice.one(target)
        detector = make_settings_detector(self._settings) if choice.select else None
        self._stage.select(first_selected(choice.selector(detector)))

    def step(self, frame: Frame) -> Track | None:
        """Return the target's track in the next frame, None while it was not found.

        Frames may have been dropped between; one that is not newer than the last is not looked at.

        Raises:
            SourceError: the box that was selected lies outside the image.
        """
        return self._stage.step(frame)

    def close(self) -> None:
        """Release the threads."""
        close_tracker(self._tracker)
