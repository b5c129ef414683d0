"""`follower track` on a live stream: breaks are bridged, Ctrl-C leaves everything complete."""

from __future__ import annotations

import re
import signal
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import pytest
from csv_rows import rows_of
from program import RunningProgram
from video_sender import sending

from follower_vision.sources.open import open_source

INTERRUPTED = 130
RATE = 20
START = (60, 100)


class Camera:
    """Sends H.264 in MPEG-TS over UDP: a red square that stands, and moves when it is told to."""

    def __init__(self, port: int) -> None:
        self.address = f"udp://127.0.0.1:{port}"
        self.moving = threading.Event()
        self._rng = np.random.default_rng(5)
        coarse = self._rng.integers(60, 180, (24, 32), dtype=np.uint8)
        grey = cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_LINEAR)
        self._ground = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        self._steps = 0

    @property
    def corner(self) -> tuple[int, int]:
        """Where the square's top-left corner is: it goes right and left again, by and by down."""
        lap = self._steps % 240
        return START[0] + min(lap, 240 - lap), START[1] + min(self._steps // 4, 60)

    def sending(self) -> AbstractContextManager[None]:
        return sending(f"{self.address}?pkt_size=1316", self._picture, RATE)

    def _picture(self, _number: int) -> np.ndarray:
        self._steps += self.moving.is_set()
        image = self._ground.copy()
        x, y = self.corner
        cv2.rectangle(image, (x, y), (x + 29, y + 29), (30, 30, 220), -1)
        cv2.rectangle(image, (x + 8, y + 8), (x + 20, y + 14), (200, 200, 40), -1)
        return cv2.add(image, self._rng.integers(0, 6, image.shape, dtype=np.uint8))


@pytest.fixture
def camera(free_port: Callable[[], int]) -> Camera:
    return Camera(free_port())


@pytest.mark.slow
def test_a_stream_that_breaks_is_followed_again_and_ctrl_c_leaves_complete_files(
    camera: Camera, tmp_path: Path, late_s: Callable[[], float]
) -> None:
    box = f"{START[0]},{START[1]},30,30"
    with camera.sending():
        follower = RunningProgram(
            "track", camera.address, "--target", box, "--save", "out.mp4", cwd=tmp_path
        )
        follower.wait_for("tracking")
        camera.moving.set()
        follower.wait_for(r"tracking [01]\.\d+ .*frames/s +delay \d+ ms +\d+ dropped")
        camera.moving.clear()
    follower.wait_for("no frames: .*(the stream broke|no stream|connecting again)")
    with camera.sending():
        follower.wait_for(r"1 reconnect\b")
        camera.moving.set()
        time.sleep(2.0)
        camera.moving.clear()
        time.sleep(1.0 + late_s())
        assert follower.end(signal.SIGINT) == INTERRUPTED, follower.said
    assert re.search(r"\d+ dropped, 1 reconnect, ", follower.said)
    (folder,) = (tmp_path / "runs").iterdir()
    rows = rows_of(folder / "boxes.csv")
    times = np.array([float(row["time"]) for row in rows])
    assert (np.diff(times) > 0).all()
    assert np.diff(times).max() > 1.5
    # A packet that a loaded machine lost costs a frame or two, perhaps the last ones.
    standing = [row for row in rows if float(row["time"]) > times[-1] - 0.8]
    seen = [row for row in standing if row["state"] == "tracking"]
    assert seen
    assert float(seen[-1]["x"]) == pytest.approx(camera.corner[0], abs=5)
    assert float(seen[-1]["y"]) == pytest.approx(camera.corner[1], abs=5)
    assert cv2.imread(str(folder / "track.png")) is not None
    assert not (folder / "setpoints.csv").exists()
    with open_source(str(tmp_path / "out.mp4")) as video:
        frames = [frame.captured_s for frame in iter(video.read, None)]
    assert len(frames) == len(rows)
    assert frames[-1] == pytest.approx(times[-1] - times[0], abs=0.1)


@pytest.mark.slow
def test_ctrl_c_while_the_target_is_awaited_leaves_nothing(camera: Camera, tmp_path: Path) -> None:
    with camera.sending():
        follower = RunningProgram("track", camera.address, "--colour", "#20e020", cwd=tmp_path)
        follower.wait_for("waiting for something of colour #20e020")
        assert follower.end(signal.SIGTERM) == INTERRUPTED, follower.said
    assert "nothing is written" in follower.said
    assert list(tmp_path.iterdir()) == []
