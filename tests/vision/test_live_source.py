"""Live sources: the newest frame, its time, and coming back after a break."""

import threading
import time
from itertools import pairwise

import av
import numpy as np
import pytest
from video_sender import sending
from waiting import until

from follower_vision.clock import MonotonicClock
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.live_source import LiveSettings, LiveSource
from follower_vision.sources.open import is_live, open_source

QUICK = LiveSettings(first_frame_s=60.0, retry_s=0.02, longest_retry_s=0.1)


def picture(number: int) -> np.ndarray:
    return np.full((48, 64, 3), number % 200 + 20, np.uint8)


class FakeCamera:
    """A connection that gives some pictures at a rate and then breaks or ends."""

    rate_hz = 50.0

    def __init__(self, count: int, breaks: bool = False, interval_s: float = 0.005) -> None:
        self.count, self.breaks, self.interval_s = count, breaks, interval_s
        self.closed = False

    def images(self):
        for number in range(self.count):
            time.sleep(self.interval_s)
            yield picture(number), MonotonicClock().now()
        if self.breaks:
            raise SourceError("camera: unplugged; plug it in")

    def close(self):
        self.closed = True


def sending_udp(port):
    """Send real H.264 in MPEG-TS over UDP, numbers as brightness, until the end of the block."""
    return sending(f"udp://127.0.0.1:{port}?pkt_size=1316", picture, 30)


@pytest.mark.slow
def test_h264_over_udp_arrives_in_order_at_its_rate_with_its_time(free_port, late_s):
    port, clock = free_port(), MonotonicClock()
    with sending_udp(port), open_source(f"udp://127.0.0.1:{port}", live=QUICK) as source:
        frames = [source.read() for _ in range(20)]
        age_s = clock.now() - frames[-1].captured_s
        rate_hz = source.nominal_rate_hz
    assert frames[0].image.shape == (48, 64, 3)
    assert all(a.captured_s < b.captured_s for a, b in pairwise(frames))
    assert all(a.sequence < b.sequence for a, b in pairwise(frames))
    assert 0 <= age_s < 1 + late_s()
    assert rate_hz == pytest.approx(30, rel=0.1)


@pytest.mark.slow
def test_a_sender_that_stops_and_starts_again_is_found_again(free_port):
    port = free_port()
    with sending_udp(port):
        source = open_source(f"udp://127.0.0.1:{port}", live=QUICK)
        last = source.read()
    with source:
        until(lambda: source.problem)
        with sending_udp(port):
            until(lambda: source.connections >= 2 and source.problem is None)
            frame = source.read()
    assert frame.captured_s > last.captured_s + 2
    assert frame.sequence > last.sequence


def test_a_slow_reader_gets_the_newest_frame_and_the_gap_shows(late_s):
    with LiveSource(lambda: FakeCamera(400), MonotonicClock(), QUICK) as source:
        first = source.read()
        until(lambda: source.skipped > 5)
        before = MonotonicClock().now()
        late = source.read()
    assert late.sequence - first.sequence > 5
    assert before - late.captured_s < 0.25 + late_s()
    assert source.skipped >= late.sequence - first.sequence - 1


def test_it_connects_again_after_a_break_and_numbers_go_on():
    made = []

    def connect():
        made.append(FakeCamera(3, breaks=True))
        return made[-1]

    with LiveSource(connect, MonotonicClock(), QUICK) as source:
        while source.connections < 3:
            frame = source.read()
    assert frame.sequence >= 3
    assert made[0].closed
    assert made[1].closed


@pytest.mark.slow
def test_the_pauses_between_attempts_grow_up_to_the_longest(late_s):
    attempts = []

    def connect():
        attempts.append(time.monotonic())
        raise SourceError("camera: not there; plug it in")

    settings = LiveSettings(retry_s=0.02, longest_retry_s=0.16)
    with LiveSource(connect, MonotonicClock(), settings) as source:
        until(lambda: len(attempts) >= 9)
        assert source.problem == "camera: not there; plug it in"
    excess_s = np.diff(attempts[:9]) - [0.02, 0.04, 0.08, *[0.16] * 5]
    assert excess_s.min() > -0.005
    assert excess_s.max() < 1 + late_s(), "doubled on, the last would be 2.56 s"


def test_an_error_of_a_library_is_no_end_either():
    attempts = []

    def connect():
        attempts.append(1)
        if len(attempts) == 1:
            raise RuntimeError("hardware decoder gone")
        return FakeCamera(1000)

    with LiveSource(connect, MonotonicClock(), QUICK) as source:
        assert source.read() is not None
    assert len(attempts) == 2


def test_the_problem_is_over_once_frames_come():
    with LiveSource(lambda: FakeCamera(1000), MonotonicClock(), QUICK) as source:
        assert source.read() is not None
        assert source.problem is None


def test_closing_lets_a_waiting_reader_go():
    source = LiveSource(lambda: FakeCamera(1, interval_s=0.0), MonotonicClock(), LiveSettings())
    assert source.read() is not None
    threading.Timer(0.1, source.close).start()
    assert source.read() is None
    assert source.read() is None


@pytest.mark.slow
def test_a_stream_that_nobody_sends_is_a_clear_error(free_port):
    settings = LiveSettings(first_frame_s=0.5, retry_s=0.05)
    with pytest.raises(SourceError, match=r"is it sending|is the camera sending"):
        open_source(f"udp://127.0.0.1:{free_port()}", live=settings)


def test_a_home_that_nobody_has_is_a_clear_error():
    with pytest.raises(SourceError, match=r"~nobody-of-that-name/clip\.mp4"):
        open_source("~nobody-of-that-name/clip.mp4")


def test_a_missing_device_is_refused_at_once():
    with pytest.raises(SourceError, match="/dev/video97: there is no such device"):
        open_source("/dev/video97")


def test_a_link_to_a_camera_is_that_camera(tmp_path):
    link = tmp_path / "frontcam"  # as udev makes one with SYMLINK+="frontcam"
    link.symlink_to("/dev/video97")
    assert is_live(str(link))
    with pytest.raises(SourceError, match="frontcam: there is no such device"):
        open_source(str(link))


@pytest.mark.parametrize(
    "address", ["rtp://0.0.0.0:99999", "udp://@:0", "rtsp://a:b@[::1]:65536/c"]
)
def test_a_port_that_there_cannot_be_is_refused_at_once(address):
    with pytest.raises(SourceError, match="a port is a number from 1 to 65535") as refused:
        open_source(address, live=LiveSettings(first_frame_s=0.2))
    assert "a:b" not in str(refused.value)


@pytest.mark.parametrize("address", ["udp://0.0.0.0", "tcp://camera/live", "UDP://a:b@camera"])
def test_a_port_that_is_missing_is_asked_for_at_once(address):
    with pytest.raises(SourceError, match="a port is missing, as in udp://") as refused:
        open_source(address, live=LiveSettings(first_frame_s=0.2))
    assert "a:b" not in str(refused.value)


@pytest.mark.slow
def test_an_address_in_capitals_is_the_same_one(free_port):
    port = free_port()
    with sending_udp(port), open_source(f"UDP://127.0.0.1:{port}", live=QUICK) as source:
        assert source.read() is not None


def test_a_protocol_that_ffmpeg_lacks_is_told(monkeypatch):
    def lacks(*_, **__):
        raise av.error.ProtocolNotFoundError(1, "Protocol not found")

    monkeypatch.setattr(av, "open", lacks)  # SRT, in the FFmpeg that comes with PyAV
    settings = LiveSettings(first_frame_s=0.5, retry_s=0.05)
    with pytest.raises(SourceError, match=r"srt://10.0.0.5:9: the FFmpeg .* does not speak"):
        open_source("srt://10.0.0.5:9", live=settings)


@pytest.mark.parametrize(
    ("spec", "live"),
    [
        ("/dev/video0", True),
        ("rtsp://10.0.0.1/live", True),
        ("udp://0.0.0.0:5600", True),
        ("gst:videotestsrc ! appsink", True),
        ("gst:" + "videotestsrc ! queue ! " * 20 + "appsink", True),
        ("flight.mp4", False),
        ("/dev/null", False),
        ("folder/img", False),
    ],
)
def test_live_sources_are_told_from_recordings(spec, live):
    assert is_live(spec) is live
