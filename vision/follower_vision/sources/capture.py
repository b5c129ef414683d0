"""How a camera or a stream is opened."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

CPU, AUTO = "cpu", "auto"
_USER_INFO = re.compile(r"(?<=://)[^/\s]+@")
_SECRET_VALUE = re.compile(
    r"(?i)((?:secret|passw(?:or)?d|passphrase|pwd|user-pw|token|credential|api_?key)[\w-]*=)[^&\s'\"]+"
)


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """What a camera is asked for; what it does not offer is refused with what it does.

    Attributes:
        format: a USB camera's pixel format by its four characters, such as MJPG or YUYV.
        size: width and height in pixels.
        rate_hz: frames a second.
        controls: values by the camera's own names: a USB camera's as `v4l2-ctl -L` lists them
            (exposure_time_absolute, gain, white_balance_automatic), a menu's entry by its name or
            number; a CSI camera's as the program or GStreamer element that reads it calls them.
        transport: what carries RTSP's pictures: tcp, or udp, which drops what comes late.
        decoder: cpu; hardware as FFmpeg calls it (cuda, drm, qsv, vaapi); auto tries all there is.
            Hardware that fails gives way to the processor.
    """

    format: str | None = None
    size: tuple[int, int] | None = None
    rate_hz: float | None = None
    controls: dict[str, bool | int | float | str] = field(default_factory=dict)
    transport: Literal["tcp", "udp"] = "tcp"
    decoder: str = CPU

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        if self.format is not None and not (self.format.isascii() and len(self.format) <= 4):
            raise ValueError(f"format is four characters such as MJPG, not {self.format!r}")
        if self.size is not None and not min(self.size) > 0:
            raise ValueError(f"size is [width, height] in pixels, not {list(self.size)}")
        if self.rate_hz is not None and not 0 < self.rate_hz <= 1000:
            raise ValueError(f"rate_hz lies between 0 and 1000, not {self.rate_hz:g}")


def without_password(text: str) -> str:
    """Return an address, or a text with addresses, as it may be shown: without passwords."""
    return _SECRET_VALUE.sub(r"\1", _USER_INFO.sub("", text))
