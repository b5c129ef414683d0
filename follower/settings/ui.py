"""Settings of the user interfaces: cockpit, ground station, live video."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal
from urllib.parse import urlsplit

from follower_control.common.strict_config import StrictFields, check_ranges

_LOOPBACK = ("127.0.0.1", "::1", "localhost")


@dataclass(frozen=True, slots=True)
class CockpitSettings(StrictFields):
    """The web page of `--cockpit`.

    Attributes:
        host: address to listen at. Off loopback a token is needed; the terminal shows it.
        port: to listen at; 0 takes a free one.
        names: host names by which the page may be called, beside localhost and addresses in
            numbers; others are refused, so that no foreign web site gets in by its own name.
        token_file: file whose first line is the token; None makes a new one for each flight.
        tls_cert: certificate (PEM) to speak https with; None speaks http.
        tls_key: its key (PEM).
        when_lost: "ignore" flies on without a page; "hold" follows only while a page has control,
            and holds, then releases when it falls silent.
        lost_s: silence of the page in control that counts as lost.
        most_clients: that may be connected at once.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    names: tuple[str, ...] = ()
    token_file: str | None = None
    tls_cert: str | None = None
    tls_key: str | None = None
    when_lost: Literal["ignore", "hold"] = "ignore"
    lost_s: float = 2.0
    most_clients: int = 64

    def __post_init__(self) -> None:
        if not self.host.strip():
            raise ValueError("host is an address to listen at, such as 127.0.0.1 or 0.0.0.0")
        check_ranges(self, port=(0, 65535), lost_s=(0.5, 60), most_clients=(1, 1000))
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("tls_cert and tls_key go together")

    @property
    def on_loopback(self) -> bool:
        """Whether nobody but this computer reaches it."""
        return self.host in _LOOPBACK

    @property
    def scheme(self) -> str:
        """What its address begins with."""
        return "http" if self.tls_cert is None else "https"


class TargetMessage(StrEnum):
    """How the target's position is reported to autopilots that can follow one."""

    NONE = "none"
    """Not at all."""
    FOLLOW_TARGET = "follow_target"
    """FOLLOW_TARGET: PX4's follow-me, ArduPilot's FOLLOW mode."""
    GLOBAL_POSITION = "global_position"
    """GLOBAL_POSITION_INT, as a vehicle of its own would report it: ArduPilot's FOLLOW mode."""
    BOTH = "both"
    """Both."""


@dataclass(frozen=True, slots=True)
class GroundStationSettings(StrictFields):
    """A MAVLink camera with tracking, and parameters, on the link to the autopilot.

    Attributes:
        enabled: whether there is all that.
        camera_component: the camera's component id, 100 to 105; another camera has another one.
        image_rate_hz: how often the target's box is reported if nobody asks for another rate.
        active_only: say that the target is tracked with the flag "active" alone, also while it is
            coasted after: some ground stations show the box only then.
        video_uri: where the ground station finds the video, such as rtsp://192.168.1.5:8554/live;
            rtp:PORT or udp://0.0.0.0:PORT for RTP by UDP. Empty: no stream is announced.
        parameters: whether gains and limits are parameters of component 191.
        target: as what the target's position is reported.
        target_rate_hz: how often.
        target_system: the MAVLink system id under which it is reported; ArduPilot takes none of its
            own.
    """

    enabled: bool = False
    camera_component: int = 100
    image_rate_hz: float = 5.0
    active_only: bool = True
    video_uri: str = ""
    parameters: bool = True
    target: TargetMessage = TargetMessage.NONE
    target_rate_hz: float = 5.0
    target_system: int = 250

    def __post_init__(self) -> None:
        check_ranges(
            self,
            camera_component=(100, 105),
            image_rate_hz=(0.1, 50),
            target_rate_hz=(0.1, 50),
            target_system=(1, 255),
        )
        if len(self.video_uri) > 159:
            raise ValueError("video_uri has up to 159 characters")


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
class VideoSettings(StrictFields):
    """Live video out of a flight. All three ways are off until they are given an address.

    Attributes:
        udp: HOST:PORT that RTP is sent to; QGroundControl listens at port 5600.
        rtsp: HOST:PORT at which rtsp://HOST:PORT/live is served; anybody who reaches it can watch.
        push: rtsp:// address of a server that the stream is pushed to, one without a password.
        overlay: draw the target and the supervisor's state into these three.
        encoder: of ffmpeg; "auto" takes the first that works here, hardware first.
        bitrate_kbit_s: about how much is sent in a second.
        max_width_px: wider pictures are made smaller.
        keyframe_s: a viewer that comes later or lost a packet sees nothing for at most so long.
    """

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
            raise ValueError(
                "push is an address such as rtsp://10.0.0.5:8554/drone, without name and password"
            )
        check_ranges(
            self, bitrate_kbit_s=(50, 50_000), max_width_px=(64, 7680), keyframe_s=(0.1, 30)
        )

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
        named = parts.username is not None or parts.password is not None
        return parts.scheme == "rtsp" and bool(parts.hostname) and parts.port != 0 and not named
    except ValueError:
        return False
