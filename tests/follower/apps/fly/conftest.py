"""A simulated autopilot behind a real UDP port, and cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest
from flying_vehicle import HEIGHT, WIDTH, Vehicle, write_square
from video_sender import sending

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
        self._rng = np.random.default_rng(5)
        self._ground = np.full((HEIGHT, WIDTH, 3), 120, np.uint8)
        cv2.rectangle(self._ground, (190, 100), (229, 139), (32, 32, 208), -1)
        cv2.rectangle(self._ground, (198, 108), (214, 120), (200, 200, 40), -1)
        self._sending = ExitStack()
        self._sending.enter_context(
            sending(f"{self.address}?pkt_size=1316", self._picture, rate_hz=20)
        )

    def stop(self) -> None:
        self._sending.close()

    def _picture(self, _number: int) -> np.ndarray:
        noise = self._rng.integers(0, 6, self._ground.shape, dtype=np.uint8)
        return np.asarray(cv2.add(self._ground, noise))


@pytest.fixture
def stream(free_port: Callable[[], int]) -> Iterator[Stream]:
    camera = Stream(free_port())
    yield camera
    camera.stop()
