"""Real video on the network, as a camera's encoder sends it."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction

import av
import numpy as np


@contextmanager
def sending(
    address: str,
    picture: Callable[[int], np.ndarray],
    rate_hz: int,
    kind: str = "mpegts",
    codec: str = "libx264",
) -> Iterator[None]:
    """Send video until the end of the block.

    Args:
        address: as FFmpeg takes it.
        picture: the image (H, W, 3), BGR, of a number.
        rate_hz: pictures a second.
        kind: container, mpegts or rtp.
        codec: FFmpeg's name of the encoder.
    """
    stop = threading.Event()
    options = {"preset": "ultrafast", "tune": "zerolatency", "g": "5"}
    options["x265-params"] = "log-level=none:keyint=5:repeat-headers=1"

    def send() -> None:
        with av.open(address, "w", format=kind) as container:
            stream = container.add_stream(codec, rate=rate_hz, options=options)
            stream.height, stream.width = picture(0).shape[:2]
            stream.pix_fmt = "yuv420p"
            number = 0
            while not stop.wait(1 / rate_hz):
                frame = av.VideoFrame.from_ndarray(picture(number), format="bgr24")
                frame.pts, frame.time_base = number, Fraction(1, rate_hz)
                container.mux(stream.encode(frame))
                number += 1

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(10)
