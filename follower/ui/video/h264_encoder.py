"""Pictures in, H.264 out, one after the other and without look-ahead."""

import math
from dataclasses import dataclass
from fractions import Fraction

import av
import av.error
import av.logging
import av.video.codeccontext
import cv2
import numpy as np
from av.video.frame import PictureType

from follower.settings.ui import VideoSettings, fitted_size
from follower_vision.images.frame import Image

TICKS_PER_S = 90_000
"""RTP's clock for video."""
_HARDWARE = ("h264_nvenc", "h264_vaapi", "h264_v4l2m2m")
_SOFTWARE = ("libx264", "libopenh264")
_NOMINAL_RATE = 30
_TRIAL = np.zeros((240, 320, 3), np.uint8)
_NEVER_BY_ITSELF = 100_000
_FAILURES = (av.error.FFmpegError, ValueError)


class EncoderError(OSError):
    """No H.264 encoder works here."""


@dataclass(frozen=True, slots=True)
class AccessUnit:
    """One encoded picture.

    Attributes:
        data: H.264 in Annex B form; a key picture brings its parameter sets along.
        ticks: when it was captured, in 1/90000 s.
        is_key: a viewer may begin here.
    """

    data: bytes
    ticks: int
    is_key: bool


class H264Encoder:
    """Encodes pictures of one size, each as soon as it comes.

    Args:
        name: ffmpeg's name of the encoder.
        settings: bit rate and distance of key pictures.
        width: of the pictures; even.
        height: likewise.

    Raises:
        av.error.FFmpegError: this encoder does not work here.
    """

    def __init__(self, name: str, settings: VideoSettings, width: int, height: int) -> None:
        self.name = name
        self.size = (width, height)
        self._keyframe_s = settings.keyframe_s
        self._key_s = -math.inf
        self._last_tick = -1
        self._context = _context(name, settings, width, height)
        self._context.open()

    def encode(self, image: Image, captured_s: float, key: bool = False) -> AccessUnit | None:
        """Encode one picture, (H, W, 3) uint8 BGR of the encoder's size.

        Args:
            image: the picture.
            captured_s: its time in seconds; one not after the last is moved behind it.
            key: begin anew with it, for a viewer who just came.

        Returns:
            The picture encoded; None if the encoder still keeps it.
        """
        yuv = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), np.uint8)
        frame = av.VideoFrame.from_ndarray(yuv, format="yuv420p")
        self._last_tick = max(round(captured_s * TICKS_PER_S), self._last_tick + 1)
        frame.pts = self._last_tick
        frame.time_base = Fraction(1, TICKS_PER_S)
        if key or not 0 <= captured_s - self._key_s < self._keyframe_s:  # a replay may go back
            frame.pict_type = PictureType.I
            self._key_s = captured_s
        packets = self._context.encode(frame)
        if not packets:
            return None
        newest = packets[-1]
        data = b"".join(bytes(packet) for packet in packets)
        return AccessUnit(data, newest.pts or 0, any(packet.is_keyframe for packet in packets))


def make_encoder(settings: VideoSettings, width: int, height: int) -> H264Encoder:
    """Return the first encoder that works: hardware, then libx264, or the one that is named.

    Raises:
        EncoderError: none works.
    """
    names = (*_HARDWARE, *_SOFTWARE) if settings.encoder == "auto" else (settings.encoder,)
    for name in names:
        try:
            # That a device is missing may show only with the first picture.
            H264Encoder(name, settings, 320, 240).encode(_TRIAL, 0.0)
            return H264Encoder(name, settings, width, height)
        except _FAILURES:
            continue
    raise EncoderError(f"no H.264 encoder works here; tried {', '.join(names)}")


def fitted(image: Image, max_width: int) -> Image:
    """Return the image, not wider than `max_width`, with even width and height."""
    height, width = image.shape[:2]
    even = fitted_size(width, height, max_width)
    if even == (width, height):
        return image
    if width <= max_width:
        return np.ascontiguousarray(image[: even[1], : even[0]])
    return np.asarray(cv2.resize(image, even, interpolation=cv2.INTER_AREA), np.uint8)


def _context(
    name: str, settings: VideoSettings, width: int, height: int
) -> av.video.codeccontext.VideoCodecContext:
    context = av.CodecContext.create(name, "w")
    if not isinstance(context, av.video.codeccontext.VideoCodecContext):
        raise EncoderError(f"{name} is no video encoder")
    context.width, context.height = width, height
    context.pix_fmt = "yuv420p"
    context.time_base = Fraction(1, TICKS_PER_S)
    context.framerate = Fraction(_NOMINAL_RATE)
    context.bit_rate = 1000 * settings.bitrate_kbit_s
    context.gop_size = _NEVER_BY_ITSELF
    context.max_b_frames = 0
    context.thread_count = 1
    rate = context.bit_rate
    # A key picture may take half a second's bits: longer bursts would come late.
    context.options = {
        "maxrate": str(rate),
        "bufsize": str(rate // 2),
        **_OPTIONS.get(name, {}),
    }
    return context


_OPTIONS: dict[str, dict[str, str]] = {
    "libx264": {
        "preset": "superfast",
        "tune": "zerolatency",
        "profile": "baseline",
        "forced-idr": "1",
    },
    "h264_nvenc": {"preset": "p1", "tune": "ull", "zerolatency": "1", "forced-idr": "1"},
}
