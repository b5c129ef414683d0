"""The video that is written plays, at the right times, whatever happens."""

import subprocess
import sys

import av
import numpy as np
import pytest

from follower_vision.drawing.video_writer import VideoWriteError, VideoWriter
from follower_vision.sources.video_file import VideoFile


def picture(number: int, width: int = 64, height: int = 48) -> np.ndarray:
    image = np.full((height, width, 3), 40 + number, np.uint8)
    image[:, : width // 2] = (200, 30, 30)
    return image


def played(path):
    with av.open(str(path)) as container:
        return [(float(f.time), f.to_ndarray(format="bgr24")) for f in container.decode(video=0)]


def test_frames_come_back_at_their_own_times(tmp_path):
    times_s = [7.0, 7.03, 7.1, 7.5, 7.51]
    with VideoWriter(tmp_path / "a.mp4") as video:
        for number, time_s in enumerate(times_s):
            video.write(picture(10 * number), time_s)
    frames = played(tmp_path / "a.mp4")
    assert [t for t, _ in frames] == pytest.approx([t - 7.0 for t in times_s], abs=1e-3)
    assert frames[0][1][10, 10] == pytest.approx([200, 30, 30], abs=12)


def test_it_is_h264_in_yuv420p_which_everything_plays(tmp_path):
    with VideoWriter(tmp_path / "a.mp4") as video:
        video.write(picture(0), 0.0)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")


@pytest.mark.parametrize(("width", "height"), [(65, 48), (64, 49), (33, 21)])
def test_odd_sizes_grow_by_a_pixel(tmp_path, width, height):
    with VideoWriter(tmp_path / "a.mp4") as video:
        video.write(picture(0, width, height), 0.0)
    image = played(tmp_path / "a.mp4")[0][1]
    assert image.shape[:2] == (height + height % 2, width + width % 2)


def test_a_frame_of_another_size_is_fitted(tmp_path):
    with VideoWriter(tmp_path / "a.mp4") as video:
        video.write(picture(0), 0.0)
        video.write(picture(0, 128, 96), 0.1)
    assert [image.shape for _, image in played(tmp_path / "a.mp4")] == [(48, 64, 3)] * 2


def test_times_that_stand_still_do_not_break_it(tmp_path):
    with VideoWriter(tmp_path / "a.mp4") as video:
        for time_s in (0.0, 0.1, 0.1, 0.05, 0.2):
            video.write(picture(0), time_s)
    times_s = [t for t, _ in played(tmp_path / "a.mp4")]
    assert len(times_s) == 5
    assert np.diff(times_s).min() > 0


def test_an_exception_leaves_a_playable_file(tmp_path):
    def fail():
        with VideoWriter(tmp_path / "a.mp4") as video:
            for number in range(10):
                video.write(picture(number), number / 30)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert len(played(tmp_path / "a.mp4")) == 10


@pytest.mark.slow
def test_a_killed_process_leaves_a_playable_file(tmp_path):
    path = tmp_path / "a.mp4"
    script = (
        "import os, numpy as np\n"
        "from follower_vision.drawing.video_writer import VideoWriter\n"
        f"video = VideoWriter({str(path)!r})\n"
        "for i in range(120):\n"
        "    video.write(np.random.default_rng(i).integers(0, 255, (96, 128, 3), np.uint8), i/30)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    code = subprocess.run([sys.executable, "-c", script], check=False, timeout=60).returncode
    assert code == -9
    with VideoFile(path) as video:
        assert len(list(iter(video.read, None))) > 60


def test_without_frames_there_is_no_file(tmp_path):
    with VideoWriter(tmp_path / "a.mp4"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_a_clear_error(tmp_path):
    with (
        pytest.raises(VideoWriteError, match="check the folder"),
        VideoWriter(tmp_path / "no" / "a.mp4") as video,
    ):
        video.write(picture(0), 0.0)


def test_a_closed_video_takes_no_more(tmp_path):
    video = VideoWriter(tmp_path / "a.mp4")
    video.write(picture(0), 0.0)
    video.close()
    video.close()
    with pytest.raises(ValueError, match="closed"):
        video.write(picture(0), 0.1)


def test_a_full_disk_is_a_clear_error_and_closing_is_quiet():
    video = VideoWriter("/dev/full")

    def fill():
        for number in range(300):
            noise = np.random.default_rng(number).integers(0, 255, (96, 128, 3), np.uint8)
            video.write(noise, number / 30)
        video.close()

    with pytest.raises(VideoWriteError, match="space left"):
        fill()
    video.close()
