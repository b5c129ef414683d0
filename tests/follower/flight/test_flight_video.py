"""The flight's video never holds up the flight."""

import threading
from pathlib import Path

import numpy as np
import pytest

from follower.flight.vision.video_sink import BackgroundVideo, OverlayVideo
from follower_vision.images.frame import Frame
from follower_vision.sources.open import open_source

RNG = np.random.default_rng(4)


def frame(number: int, side: int = 64) -> Frame:
    return Frame(RNG.integers(0, 255, (side, side, 3), dtype=np.uint8), number / 30, number)


def frames_in(path: Path) -> int:
    with open_source(str(path)) as source:
        count = 0
        while source.read() is not None:
            count += 1
        return count


@pytest.mark.parametrize("kind", [OverlayVideo, BackgroundVideo])
def test_every_frame_handed_in_at_leisure_is_in_the_file(
    kind: type[OverlayVideo | BackgroundVideo], tmp_path: Path
) -> None:
    path = tmp_path / "video.mp4"
    with kind(path, 30.0) as video:
        for number in range(20):
            video.add(frame(number), (), ("a line",))
    assert frames_in(path) == 20
    assert video.remark is None


@pytest.mark.slow
def test_a_burst_leaves_frames_out_and_says_so_but_never_waits(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    with BackgroundVideo(path, 30.0) as video:
        for number in range(300):
            video.add(frame(number, 640), (), ())
    assert video.remark is not None
    assert "leaves out" in video.remark
    assert 0 < frames_in(path) < 300


def test_a_video_that_cannot_be_written_is_a_remark_and_no_end(tmp_path: Path) -> None:
    threads = threading.active_count()
    with BackgroundVideo(tmp_path / "missing" / "video.mp4", 30.0) as video:
        for number in range(100):
            video.add(frame(number), (), ())
    assert video.remark is not None
    assert "ends early" in video.remark
    assert threading.active_count() == threads


def test_a_video_leaves_the_room_that_other_files_need(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = iter([50e6, 20e6, 50e6])  # two looks, 30 frames apart, and what is told
    monkeypatch.setattr("follower_vision.disk.free_bytes", lambda _: next(free))
    path = tmp_path / "video.mp4"
    with OverlayVideo(path, 30.0, keep_free_mb=30) as video:
        for number in range(100):
            video.add(frame(number), (), ())
    assert frames_in(path) == 30
    assert video.remark.startswith("The video ends early: other files need the room")


@pytest.mark.parametrize("breaks", ["draw_tracks", "VideoWriter.close"])
@pytest.mark.parametrize("patient", [False, True])
def test_a_writer_that_breaks_holds_nobody_up(
    tmp_path: Path, patient: bool, breaks: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(f"follower.flight.vision.video_sink.{breaks}", broken)
    with BackgroundVideo(tmp_path / "video.mp4", 30.0, patient) as video:
        for number in range(100):
            video.add(frame(number), (), ())
    assert video.remark.startswith("The video ends early: ZeroDivisionError")
