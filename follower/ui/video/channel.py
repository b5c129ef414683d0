"""One live stream, encoded once for all who watch it, and only while somebody does."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import av.error

from follower.settings.ui import VideoSettings
from follower.ui.video.h264_encoder import AccessUnit, H264Encoder, fitted, make_encoder
from follower_vision.drawing.overlay import draw_tracks
from follower_vision.images.frame import Image
from follower_vision.trackers.track import Track

SEND_BUFFER_BYTES = 1 << 16
"""Of a line that carries live video, set where it is listened: accepted lines inherit it.

Linux by itself keeps megabytes for a slow line, seconds of video that is then shown as live.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What vision answered for.

    Attributes:
        image: (H, W, 3) uint8 BGR.
        sequence: the frame's number.
        captured_s: when, in seconds on the flight's clock.
        tracks: where the targets are, none while there is none.
        lines: text for the corner.
    """

    image: Image
    sequence: int
    captured_s: float
    tracks: tuple[Track, ...] = ()
    lines: tuple[str, ...] = ()


Viewer: TypeAlias = Callable[[AccessUnit], None]
"""Takes each encoded picture on the encoder's thread; returns at once."""


class VideoChannel:
    """Encodes pictures for its viewers. `watch` may be called from any thread.

    Args:
        settings: of the encoder.
        overlay: draw tracks and lines into the picture.

    Attributes:
        key_unit: the newest key picture, None before the first.
    """

    def __init__(self, settings: VideoSettings, overlay: bool) -> None:
        self._settings = settings
        self._overlay = overlay
        self._encoder: H264Encoder | None = None
        self._lock = threading.Lock()
        self._viewers: list[Viewer] = []
        self._key_wanted = False
        self.key_unit: AccessUnit | None = None

    @property
    def watched(self) -> bool:
        """Whether there is any viewer."""
        return bool(self._viewers)

    def watch(self, viewer: Viewer) -> Callable[[], None]:
        """Give each picture from the next key picture on to `viewer`, until the result is called.

        The next picture is a key picture.
        """
        with self._lock:
            self._viewers = [*self._viewers, viewer]
            self._key_wanted = True

        def leave() -> None:
            with self._lock:
                self._viewers = [one for one in self._viewers if one is not viewer]

        return leave

    def ask_for_key(self) -> None:
        """Begin anew with the next picture: a viewer lost something."""
        self._key_wanted = True

    def show(self, picture: Picture) -> None:
        """Encode a picture and give it to whoever watches.

        Raises:
            EncoderError: no encoder works here.
        """
        viewers = self._viewers
        if not viewers:
            return
        wanted, self._key_wanted = self._key_wanted, False
        unit = self._encoded(self._drawn(picture), picture.captured_s, wanted)
        if unit is None:
            self._key_wanted = self._key_wanted or wanted
            return
        if unit.is_key:
            self.key_unit = unit
        for viewer in viewers:
            viewer(unit)

    def _drawn(self, picture: Picture) -> Image:
        image = picture.image
        if self._overlay:
            image = draw_tracks(image, picture.tracks, picture.lines)
        return fitted(image, self._settings.max_width_px)

    def _encoded(self, image: Image, captured_s: float, key: bool) -> AccessUnit | None:
        height, width = image.shape[:2]
        if self._encoder is None or self._encoder.size != (width, height):
            self._encoder = make_encoder(self._settings, width, height)
        try:
            return self._encoder.encode(image, captured_s, key)
        except (av.error.FFmpegError, ValueError):
            self._encoder = None  # hardware may go away; the next picture tries anew
            return None
