"""One open connection to a live camera or stream."""

from __future__ import annotations

import io
import logging
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import av
import av.container
import av.error
import cv2
import numpy as np
from av.codec.hwaccel import HWAccel, hwdevices_available

from follower_vision.clock import Clock
from follower_vision.images.frame import Image
from follower_vision.sources import v4l2
from follower_vision.sources.camera_program import CameraProgram
from follower_vision.sources.capture import AUTO, CPU, CaptureSettings, without_password
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.stream_clock import StreamClock
from follower_vision.sources.video_file import next_packet, upright

_LOGGER = logging.getLogger(__name__)
_OPEN_S, _SILENCE_S = 5.0, 2.0
"""For a stream to be reached and recognised; without data for so long it is broken."""
_LOW_DELAY = {
    "fflags": "nobuffer",
    "flags": "low_delay",
    "probesize": "500000",
    "analyzeduration": "500000",
}
_SDP_PROTOCOLS = "file,crypto,data,rtp,udp"
_CODECS = {"h264": "H264", "h265": "H265"}
"""Their names in a session description."""
_RTP = re.compile(r"rtp://(?P<host>[\w.-]+):(?P<port>\d{1,5})(/(?P<codec>h264|h265))?/?")
_PORT = re.compile(r"\w+://[^/?#]*:(\d+)(?:[/?#]|$)")
_NEED_PORT = ("udp://", "tcp://", "srt://")
_OLDEST_S = 10.0
"""A V4L2 stamp that is older is not of the monotonic clock."""


class Connection(Protocol):
    """An open camera or stream; when it breaks, another one is made."""

    @property
    def rate_hz(self) -> float | None:
        """Frames a second as the other side declares them; None if it does not."""
        ...

    def images(self) -> Iterator[tuple[Image, float]]:
        """Yield (image, time) as they come; end where the stream ends.

        Each image is an array of its own, (H, W, 3) uint8 BGR, and is kept: no buffer that the
        next one is written into. The time, in seconds of the clock handed in, is the capture by
        the camera's clock, put on ours, or the arrival where there is no such clock. What both
        are late by is `camera.latency_s`.

        Raises:
            SourceError: the stream broke or went silent.
        """
        ...

    def close(self) -> None:
        """Release the camera or the socket."""
        ...


class Decoder:
    """Hardware that decodes, until it fails; then the processor does, with one warning.

    Args:
        name: "cpu", "auto", or a device as FFmpeg calls it.

    Raises:
        SourceError: this FFmpeg has no such device.
    """

    def __init__(self, name: str) -> None:
        devices = hwdevices_available()
        if name not in (CPU, AUTO, *devices):
            raise SourceError(
                f"camera.capture.decoder {name}: there are {', '.join((AUTO, CPU, *devices))}"
            )
        self._device: str | None = None
        faults = []
        for device in {CPU: [], AUTO: devices}.get(name, [name]):
            try:
                HWAccel(device).create(av.Codec("h264", "r"))
            except (av.error.FFmpegError, OSError, RuntimeError) as error:
                faults.append(f"{device}: {_reason(error)}")
            else:
                self._device = device
                return
        if faults:
            self.give_up("; ".join(faults))

    @property
    def hwaccel(self) -> HWAccel | None:
        """What PyAV is to decode with; None for the processor."""
        return None if self._device is None else HWAccel(self._device)

    def check(self, context: av.VideoCodecContext) -> None:
        """Give the hardware up where PyAV did, because it does not decode this stream."""
        if self._device is not None and not context.is_hwaccel:
            self.give_up(f"{self._device} does not decode {context.name}")

    def give_up(self, reason: str) -> None:
        """Let the processor decode from now on."""
        self._device = None
        _LOGGER.warning("hardware does not decode, the processor does: %s", reason)


class VideoStream:
    """Whatever FFmpeg opens by an address, an SDP text, or from a program's pipe.

    Args:
        shown: its name without a password.
        source: address, or file.
        clock: times the arrival of packets, before they are decoded.
        decoder: shared by one source's connections: what has failed is not tried again.
        form: of the stream, where FFmpeg is not to guess.
        options: for FFmpeg.

    Raises:
        SourceError: no connection, or no video in it.
    """

    def __init__(
        self,
        shown: str,
        source: str | io.BytesIO | CameraProgram,
        clock: Clock,
        decoder: Decoder,
        form: str | None = None,
        options: dict[str, str] | None = None,
    ) -> None:
        self._shown = shown
        self._clock = clock
        self._decoder = decoder
        self._stamps = StreamClock()
        self._program = source if isinstance(source, CameraProgram) else None
        try:
            self._container = av.open(
                source,
                "r",
                format=form,
                options=_LOW_DELAY | (options or {}),
                metadata_errors="replace",
                timeout=(_OPEN_S, _SILENCE_S),
                hwaccel=decoder.hwaccel,
            )
        except av.error.ProtocolNotFoundError as error:
            raise self._error("the FFmpeg that is installed does not speak this") from error
        except (av.error.FFmpegError, OSError) as error:
            raise self._error(f"no stream ({_reason(error)}); is it sending?") from error
        if not self._container.streams.video:
            self._container.close()
            raise self._error("there is no video in this stream")
        self._stream = self._container.streams.video[0]
        # Threads that decode several frames at once would give each of them late.
        self._stream.thread_type = "SLICE"
        decoder.check(self._stream.codec_context)

    @classmethod
    def address(cls, address: str, clock: Clock, decoder: Decoder, transport: str) -> VideoStream:
        """Open e.g. "rtsp://192.168.1.10/live" or "udp://0.0.0.0:5600" (MPEG-TS)."""
        options = {}
        if address.startswith("udp"):
            options["overrun_nonfatal"] = "1"
        if address.startswith("rtsp"):
            options["rtsp_transport"] = transport
        return cls(without_password(address), address, clock, decoder, options=options)

    @classmethod
    def sdp(cls, shown: str, text: str, clock: Clock, decoder: Decoder) -> VideoStream:
        """Open RTP as a session description says."""
        options = {"protocol_whitelist": _SDP_PROTOCOLS}
        return cls(shown, io.BytesIO(text.encode()), clock, decoder, "sdp", options)

    @classmethod
    def program(
        cls, kind: str, where: str, clock: Clock, decoder: Decoder, capture: CaptureSettings
    ) -> VideoStream:
        """Start one of `PROGRAMS` and open what it writes."""
        program = CameraProgram(kind, where, capture)
        try:
            return cls(without_password(f"{kind}:{where}"), program, clock, decoder)
        except BaseException:
            program.close()
            raise

    @property
    def rate_hz(self) -> float | None:
        """The rate that the stream declares."""
        rate = self._stream.average_rate or self._stream.guessed_rate
        return float(rate) if rate else None

    def images(self) -> Iterator[tuple[Image, float]]:
        """Yield decoded pictures; a packet that cannot be decoded (loss on the way) is skipped."""
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next_packet(packets)
            except (av.error.FFmpegError, OSError) as error:
                raise self._error(f"the stream broke ({_reason(error)})") from error
            if packet is None:
                raise self._error("the stream ended")
            arrival_s = self._clock.now()
            for picture in self._decoded(packet):
                yield upright(picture), self._stamps.captured_s(picture.time, arrival_s)

    def _decoded(self, packet: av.Packet[Any]) -> list[av.VideoFrame]:
        try:
            return packet.decode()
        except av.error.InvalidDataError:
            return []
        except (av.error.FFmpegError, OSError) as error:
            if self._decoder.hwaccel is not None:
                self._decoder.give_up(_reason(error))
            raise self._error(f"cannot be decoded ({_reason(error)})") from error

    def _error(self, what: str) -> SourceError:
        """Return what is wrong: what the program says, or else `what`."""
        problem = None if self._program is None else self._program.problem
        return SourceError(f"{self._shown}: {problem or what}")

    def close(self) -> None:
        """Close the connection."""
        self._container.close()
        if self._program is not None:
            self._program.close()


class CaptureDevice:
    """A V4L2 device, through OpenCV.

    Args:
        path: such as "/dev/video0".
        clock: times the pictures where the driver does not.
        capture: what is asked for.

    Raises:
        SourceError: it cannot be opened, or does not offer what is asked for.
    """

    def __init__(self, path: str, clock: Clock, capture: CaptureSettings) -> None:
        check_device(path)
        v4l2.prepare(path, capture)
        self._path = path
        self._clock = clock
        self._stamps = StreamClock()
        self._capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            self._capture.release()
            raise SourceError(
                f"{path}: cannot be opened; is it there, and used by no other program?"
            )
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        asked = list(_asked(capture))
        for _, key, value in asked:
            self._capture.set(key, value)
        for name, key, value in asked:
            given = self._capture.get(key)
            if abs(given - value) > 0.01 * value:
                self._capture.release()
                raise SourceError(f"{path}: takes {given:g} as its {name}, not {value:g}")

    @property
    def rate_hz(self) -> float | None:
        """The rate that the device declares."""
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        return rate if 0 < rate < 1000 else None

    def images(self) -> Iterator[tuple[Image, float]]:
        """Yield pictures until the device gives no more, with the driver's times."""
        while True:
            good, image = self._capture.read()
            if not good:
                raise SourceError(f"{self._path}: gives no more pictures; was it unplugged?")
            # Drivers stamp by the monotonic clock; what is no time of it counts as no stamp.
            age_s = time.monotonic() - self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            late_s = age_s if 0 <= age_s < _OLDEST_S else 0.0
            captured_s = self._stamps.captured_s(None, self._clock.now() - late_s)
            yield np.asarray(image, np.uint8), captured_s

    def close(self) -> None:
        """Release the device."""
        self._capture.release()


def _asked(capture: CaptureSettings) -> Iterator[tuple[str, int, float]]:
    """Yield the name, OpenCV's property and the value of what is asked for, in V4L2's order."""
    if capture.format is not None:
        yield "format", cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*capture.format.ljust(4))
    if capture.size is not None:
        yield "width", cv2.CAP_PROP_FRAME_WIDTH, capture.size[0]
        yield "height", cv2.CAP_PROP_FRAME_HEIGHT, capture.size[1]
    if capture.rate_hz is not None:
        yield "rate", cv2.CAP_PROP_FPS, capture.rate_hz


def check_port(address: str) -> None:
    """Raise SourceError if an address lacks a port, or names one that there cannot be.

    FFmpeg would wait.
    """
    port = _PORT.match(address)
    if port is None and address.startswith(_NEED_PORT):
        raise SourceError(
            f"{without_password(address)}: a port is missing, as in {_NEED_PORT[0]}0.0.0.0:5600"
        )
    if port is not None and not 0 < int(port[1]) <= 65535:
        raise SourceError(f"{without_password(address)}: a port is a number from 1 to 65535")


def rtp_description(address: str) -> str:
    """Return the session description (SDP) of e.g. "rtp://0.0.0.0:5600/h265", payload type 96.

    Raises:
        SourceError: there is no port, or a codec that is not known.
    """
    matched = _RTP.fullmatch(address)
    if matched is None:
        raise SourceError(
            f"{address}: write rtp://0.0.0.0:PORT, rtp://0.0.0.0:PORT/{'|'.join(_CODECS)}, or "
            "give the sender's session description as a file, NAME.sdp"
        )
    host, port, codec = matched["host"], matched["port"], _CODECS[matched["codec"] or "h264"]
    lines = [
        *("v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=-", f"c=IN IP4 {host}", "t=0 0"),
        *(f"m=video {port} RTP/AVP 96", f"a=rtpmap:96 {codec}/90000"),
    ]
    return "\r\n".join([*lines, ""])


def check_device(path: str) -> None:
    """Raise SourceError if there is no such device, or if it may not be used."""
    if not Path(path).exists():
        raise SourceError(f"{path}: there is no such device; `ls /dev/video*` shows them")
    if not os.access(path, os.R_OK | os.W_OK):
        raise SourceError(
            f"{path}: no permission; `sudo usermod -aG video $USER` and a new login give it"
        )


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return "nothing came in time" if "Immediate exit" in text else without_password(text)
