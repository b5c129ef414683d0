"""Small recordings in the formats of other drones and cameras, as those write them."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

RATE_HZ, WIDTH, HEIGHT, FOV_DEG = 20, 320, 240, 40.0
FOCAL_PX = WIDTH / 2 / math.tan(math.radians(FOV_DEG) / 2)
LATITUDE, LONGITUDE = 47.3769, 8.5417


def yaw_rad(time_s: float) -> float:
    """How the camera pans."""
    return 0.10 * math.sin(1.3 * time_s) + 0.05 * math.sin(3.7 * time_s + 1)


def yaw_rate_rad_s(time_s: float) -> float:
    return 0.13 * math.cos(1.3 * time_s) + 0.185 * math.cos(3.7 * time_s + 1)


def pictures(seconds: float, pans: bool = True) -> Iterable[np.ndarray]:
    """What the panning camera sees: a wall of noise far away."""
    noise = np.random.default_rng(3).integers(0, 256, (HEIGHT // 6, 160), np.uint8)
    wall = cv2.resize(noise, (960, HEIGHT), interpolation=cv2.INTER_CUBIC)
    wall = cv2.cvtColor(wall, cv2.COLOR_GRAY2BGR)
    for n in range(round(seconds * RATE_HZ)):
        shift = FOCAL_PX * math.tan(yaw_rad(n / RATE_HZ)) if pans else 0.0
        move = np.array([[1.0, 0.0, -320 - shift], [0.0, 1.0, 0.0]])
        yield cv2.warpAffine(wall, move, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)


def write_video(
    path: Path,
    seconds: float,
    data: str | None = None,
    packets: Sequence[tuple[float, float, bytes]] = (),
    pans: bool = True,
    codec: str = "mpeg4",
    **coding: str,
) -> Path:
    """Write a video and, as a stream of its own, data packets of (time, duration, bytes)."""
    tick = Fraction(1, 90_000)
    with av.open(str(path), "w") as container:
        video = container.add_stream(codec, rate=RATE_HZ, options=coding)
        video.width, video.height, video.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        video.bit_rate = 4_000_000
        stream = None if data is None else container.add_data_stream(data)
        if stream is not None:
            stream.time_base = tick
        waiting = list(packets)
        for n, image in enumerate(pictures(seconds, pans)):
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts = n
            container.mux(video.encode(frame))
            while waiting and waiting[0][0] <= n / RATE_HZ:
                time_s, duration_s, payload = waiting.pop(0)
                packet = av.Packet(payload)
                packet.stream, packet.time_base = stream, tick
                packet.pts = packet.dts = round(time_s * 90_000)
                packet.duration = round(duration_s * 90_000)
                container.mux(packet)
        container.mux(video.encode(None))
    return path


def subtitles(lines: Callable[[float], str], seconds: float, rate_hz: float = RATE_HZ) -> str:
    """Return an .SRT whose cues say `lines(time)`."""
    cues = []
    for n in range(round(seconds * rate_hz)):
        begin, end = (_clock((n + k) / rate_hz) for k in (0, 1))
        cues.append(f"{n + 1}\n{begin} --> {end}\n{lines(n / rate_hz)}\n\n")
    return "".join(cues)


def _clock(time_s: float) -> str:
    whole, thousandths = divmod(round(time_s * 1000), 1000)
    return f"{whole // 3600:02}:{whole // 60 % 60:02}:{whole % 60:02},{thousandths:03}"


_KLV_KEY = bytes.fromhex("060e2b34020b01010e01030101000000")
_KLV_RANGES: dict[int, tuple[str, float]] = {
    5: (">H", 65535 / 360), 6: (">h", 32767 / 20), 7: (">h", 32767 / 50),
    13: (">i", (2**31 - 1) / 90), 14: (">i", (2**31 - 1) / 180),
    15: (">H", 65535 / 19900), 16: (">H", 65535 / 180),
    18: (">I", (2**32 - 1) / 360), 19: (">i", (2**31 - 1) / 180), 20: (">I", (2**32 - 1) / 360),
    25: (">H", 65535 / 19900),
}  # fmt: skip


def klv_packet(stamp_us: int, values: Mapping[int, float]) -> bytes:
    """Return a packet of MISB ST 0601 as its standard describes it, with a tag nobody knows."""
    body = b"\x02\x08" + struct.pack(">Q", stamp_us) + b"\x03\x04TEST" + b"\x81\x7f\x01\x00"
    for tag, value in values.items():
        letter, scale = _KLV_RANGES[tag]
        least = -900 if tag in (15, 25) else 0
        data = struct.pack(letter, round((value - least) * scale))
        body += bytes([tag, len(data)]) + data
    body += b"\x01\x02"
    length = len(body) + 2
    packet = _KLV_KEY + (b"" if length < 128 else b"\x81") + bytes([length]) + body
    total = sum(byte << (8 if n % 2 == 0 else 0) for n, byte in enumerate(packet))
    return packet + struct.pack(">H", total & 0xFFFF)


def gpmf(key: str, kind: str, size: int, data: bytes) -> bytes:
    """Return one element of GPMF."""
    head = key.encode() + (b"\0" if not kind else kind.encode())
    repeat = len(data) // size
    return head + bytes([size]) + struct.pack(">H", repeat) + data + bytes(-len(data) % 4)


def gpmf_stream(key: str, kind: str, rows: Any, scale: Sequence[int], *before: bytes) -> bytes:
    """Return a stream (STRM) of integers: rows (N, columns) times `scale`."""
    table = np.round(np.asarray(rows) * scale).astype({"s": ">i2", "l": ">i4"}[kind])
    scales = struct.pack(f">{len(scale)}l", *scale)
    data = table.tobytes()
    inside = b"".join(before) + gpmf("SCAL", "l", 4, scales)
    inside += gpmf(key, kind, table.shape[1] * table.itemsize, data)
    return gpmf("STRM", "", 1, inside)


def gopro_payload(begin_s: float, late_s: float, total: int, orientation: str = "ZXY") -> bytes:
    """Return one second of a GoPro that pans level, looks north and flies there at 4 m/s.

    Its axes are X to the left, Y back, Z up; `late_s` is how much later than the pictures its
    sensors are.
    """
    times = [begin_s + n / 100 for n in range(100)]
    turn = {"X": 0.0, "Y": 0.0, "Z": 1.0}

    def row(values: Mapping[str, float]) -> list[float]:
        return [values[a.upper()] * (1 if a.isupper() else -1) for a in orientation]

    gyro = [row({a: -k * yaw_rate_rad_s(t - late_s) for a, k in turn.items()}) for t in times]
    force = [row({a: 9.81 * k for a, k in turn.items()}) for _ in times]
    marks = (
        gpmf("STMP", "J", 8, struct.pack(">Q", round(1e6 * begin_s) + 250_000)),
        gpmf("TSMP", "L", 4, struct.pack(">L", total)),
        gpmf("ORIN", "c", 1, orientation.encode()),
    )
    north_deg = math.degrees(1 / 6_371_000)
    fixes = [
        [LATITUDE + 4 * north_deg * (begin_s + n / 10), LONGITUDE, 520.0, 4.0, 4.0]
        for n in range(10)
    ]
    places = gpmf_stream(
        "GPS5", "l", fixes, [10**7, 10**7, 1000, 1000, 100], gpmf("GPSF", "L", 4, b"\0\0\0\3")
    )
    streams = (
        gpmf("DVNM", "c", 1, b"HERO9 Black")
        + gpmf_stream("ACCL", "s", force, [417] * 3, *marks)
        + gpmf_stream("GYRO", "s", gyro, [939] * 3, *marks)
        + places
    )
    return gpmf("DEVC", "", 1, streams)
