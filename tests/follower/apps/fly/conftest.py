"""A simulated autopilot behind a real UDP port, and cameras."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from flying_vehicle import HEIGHT, WIDTH, Vehicle, write_square

MakeVehicle = Callable[..., Vehicle]


@pytest.fixture
def vehicle(port: int) -> Iterator[MakeVehicle]:
    """Make vehicles that speak to `port`, and end them."""
    made: list[Vehicle] = []

    def make(flavour: str, height_m: float = 0.0) -> Vehicle:
        made.append(Vehicle(flavour, port, height_m))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture(scope="session")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty seconds of the square."""
    return write_square(tmp_path_factory.mktemp("video") / "square.mp4", 20)


class Stream:
    """Sends the video's scene as H.264 in MPEG-TS over UDP, as a camera's encoder does."""

    def __init__(self, port: int) -> None:
        self.address = f"udp://127.0.0.1:{port}"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(10)

    def _send(self) -> None:
        rng = np.random.default_rng(5)
        ground = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
        cv2.rectangle(ground, (190, 100), (229, 139), (32, 32, 208), -1)
        cv2.rectangle(ground, (198, 108), (214, 120), (200, 200, 40), -1)
        options = {"preset": "ultrafast", "tune": "zerolatency", "g": "10"}
        with av.open(f"{self.address}?pkt_size=1316", "w", format="mpegts") as container:
            stream = container.add_stream("libx264", rate=20, options=options)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            number = 0
            while not self._stop.wait(1 / 20):
                image = cv2.add(ground, rng.integers(0, 6, ground.shape, dtype=np.uint8))
                frame = av.VideoFrame.from_ndarray(image, format="bgr24")
                frame.pts, frame.time_base = number, Fraction(1, 20)
                container.mux(stream.encode(frame))
                number += 1


@pytest.fixture
def stream(free_port: Callable[[], int]) -> Iterator[Stream]:
    camera = Stream(free_port())
    yield camera
    camera.stop()
