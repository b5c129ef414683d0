"""What leaves as live video, and to whom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal
from urllib.parse import urlsplit

EncoderName = Literal["auto", "libx264", "libopenh264", "h264_v4l2m2m", "h264_nvenc", "h264_vaapi"]


@dataclass(frozen=True, slots=True)
class Address:
    """Host and port."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Address:
        """Read "192.168.1.20:5600" or "[::1]:8554".

        Raises:
            ValueError: it is neither.
        """
        host, separator, port = text.strip().rpartition(":")
        if not separator or not host or not port.isdecimal() or not 0 <= int(port) <= 65535:
            raise ValueError(f"write HOST:PORT, for example 192.168.1.20:5600, not {text!r}")
        return cls(host.strip("[]"), int(port))


@dataclass(frozen=True, slots=True)
class VideoSettings:
    """Live video out of a flight. All three ways are off until they are given an address.

    Attributes:
        udp: HOST:PORT that RTP is sent to; QGroundControl listens at port 5600.
        rtsp: HOST:PORT at which rtsp://HOST:PORT/live is served; anybody who reaches it can watch.
        push: rtsp:// address of a server that the stream is pushed to.
        overlay: draw the target and the supervisor's state into these three.
        encoder: of ffmpeg; "auto" takes the first that works here, hardware first.
        bitrate_kbit_s: about how much is sent in a second.
        max_width_px: wider pictures are made smaller.
        keyframe_s: a viewer that comes later or lost a packet sees nothing for at most so long.
    """

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    udp: str | None = None
    rtsp: str | None = None
    push: str | None = None
    overlay: bool = True
    encoder: EncoderName = "auto"
    bitrate_kbit_s: int = 2000
    max_width_px: int = 1280
    keyframe_s: float = 1.0

    def __post_init__(self) -> None:
        for address in (self.udp, self.rtsp):
            if address is not None:
                Address.parse(address)
        if self.push is not None and not _is_rtsp(self.push):
            raise ValueError(f"push is an address such as rtsp://10.0.0.5:8554/drone: {self.push}")
        if not 50 <= self.bitrate_kbit_s <= 50_000:
            raise ValueError(f"bitrate_kbit_s lies between 50 and 50000: {self.bitrate_kbit_s}")
        if not 64 <= self.max_width_px <= 7680:
            raise ValueError(f"max_width_px lies between 64 and 7680, not {self.max_width_px}")
        if not 0.1 <= self.keyframe_s <= 30:
            raise ValueError(f"keyframe_s lies between 0.1 and 30 s, not {self.keyframe_s}")

    @property
    def on(self) -> bool:
        """Whether anything is to be sent."""
        return any(way is not None for way in (self.udp, self.rtsp, self.push))


def fitted_size(width: int, height: int, max_width: int) -> tuple[int, int]:
    """Return the size in which a picture is sent: not wider than that, both sides even."""
    scale = min(1.0, max_width / width)
    return _even(width * scale), _even(height * scale)


def _even(length: float) -> int:
    return max(2, int(length) // 2 * 2)


def _is_rtsp(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return parts.scheme == "rtsp" and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False
