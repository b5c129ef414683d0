"""Cameras as people have them: RTP, programs that film, GStreamer, RTSP servers, V4L2."""

import errno
import logging
import os
import shutil
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from video_sender import sending
from waiting import until

from follower_vision.clock import MonotonicClock
from follower_vision.sources import v4l2
from follower_vision.sources.camera_connection import Decoder, VideoStream
from follower_vision.sources.camera_program import PROGRAMS, CameraProgram, ProgramKind
from follower_vision.sources.capture import CaptureSettings
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.live_source import LiveSettings, LiveSource
from follower_vision.sources.open import GIMBALS, is_live, open_source

PATIENT = LiveSettings(first_frame_s=60.0, retry_s=0.05, longest_retry_s=0.2)
RATE = 25
FreePort = Callable[[], int]


def sending_rtp(port: int, codec: str = "libx264") -> AbstractContextManager[None]:
    """Send real RTP until the end of the block."""
    address = f"rtp://127.0.0.1:{port}?pkt_size=1200"
    return sending(address, grey, RATE, kind="rtp", codec=codec)


def grey(number: int) -> np.ndarray:
    return np.full((64, 96, 3), 20 + number % 200, np.uint8)


def until_connected_again(source: LiveSource) -> None:
    until(lambda: source.connections >= 2 and source.problem is None)


@pytest.mark.slow
def test_rtp_is_received_and_a_sender_that_comes_back_is_found_again(free_port: FreePort) -> None:
    port = free_port()
    with sending_rtp(port):
        source = open_source(f"rtp://127.0.0.1:{port}", live=PATIENT)
        before = source.read()
    assert before.image.shape == (64, 96, 3)
    with source:
        until(lambda: source.problem)
        with sending_rtp(port):
            until_connected_again(source)
            after = source.read()
    assert after.captured_s > before.captured_s + 1.5, "it was silent for two seconds"


@pytest.mark.slow
def test_a_session_description_says_what_else_is_sent(free_port: FreePort, tmp_path: Path) -> None:
    if "libx265" not in av.codecs_available:
        pytest.skip("this FFmpeg encodes no H.265")
    port, sdp = free_port(), tmp_path / "camera.sdp"
    sdp.write_text(
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\n"
        f"m=video {port} RTP/AVP 96\na=rtpmap:96 H265/90000\n"
    )
    with sending_rtp(port, "libx265"), open_source(str(sdp), live=PATIENT) as source:
        frame = source.read()
    assert frame.image.shape == (64, 96, 3)


FILM = """
import pathlib, random, sys, time
from fractions import Fraction
import av, numpy as np
pathlib.Path({notes!r}).write_text(" ".join(sys.argv[1:]))
out = open(1, "wb", buffering=0, closefd=False)
with av.open(out, "w", format="mpegts", options={{"flush_packets": "1"}}) as container:
    options = {{"preset": "ultrafast", "tune": "zerolatency", "g": "5"}}
    stream = container.add_stream("libx264", rate=25, options=options)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    chance, start = random.Random(1), time.monotonic()
    for number in range({count}):
        due = start + number / 25 + chance.random() ** 3 * {jitter_s}
        time.sleep(max(0.0, due - time.monotonic()))
        image = np.full((48, 64, 3), 20 + number % 200, np.uint8)
        frame = av.VideoFrame.from_ndarray(image, format="bgr24")
        frame.pts, frame.time_base = number, Fraction(1, 25)
        container.mux(stream.encode(frame))
print("ERROR: *** the sensor is gone ***", file=sys.stderr)
print("closing", file=sys.stderr)
sys.exit(3)
"""


@pytest.fixture
def film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Put a program in rpicam-vid's place that writes a real MPEG-TS; its arguments are noted."""

    def install(count: int, jitter_s: float = 0.0) -> Path:
        program, notes = tmp_path / "rpicam-vid", tmp_path / "arguments"
        code = FILM.format(notes=str(notes), count=count, jitter_s=jitter_s)
        program.write_text(f"#!{sys.executable}\n{code}")
        program.chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
        return notes

    return install


@pytest.mark.slow
def test_a_program_that_films_is_asked_for_what_is_set_and_started_anew_when_it_ends(
    film: Callable[..., Path],
) -> None:
    notes = film(count=40)
    capture = CaptureSettings(size=(64, 48), rate_hz=25, controls={"shutter": 5000})
    with open_source("rpicam:1", live=PATIENT, capture=capture) as source:
        problems: set[str | None] = set()
        while source.connections < 3:
            problems.add(source.problem)
            time.sleep(0.005)
        frame = source.read()
    assert frame.image.shape == (48, 64, 3)
    told = "rpicam:1: rpicam-vid ended: ERROR: *** the sensor is gone ***; it needs rpicam-apps"
    assert told in problems
    asked = notes.read_text()
    assert asked.startswith("--camera 1 ")
    assert "--width 64 --height 48 --framerate 25 --shutter 5000 " in asked


@pytest.mark.slow
def test_stamps_are_far_evener_than_arrivals(film: Callable[..., Path]) -> None:
    film(count=150, jitter_s=0.12)
    clock = MonotonicClock()
    rows: list[tuple[float, float]] = []
    stream = VideoStream.program("rpicam", "0", clock, Decoder("cpu"), CaptureSettings())
    arriving = ((captured_s, clock.now()) for _, captured_s in stream.images())
    with closing(stream), pytest.raises(SourceError, match="the sensor is gone"):
        rows.extend(arriving)
    captured_s, arrival_s = np.array(rows[40:]).T
    taken_s = np.arange(len(captured_s)) / RATE
    assert len(captured_s) > 60
    assert np.all(captured_s < arrival_s)
    assert (captured_s - taken_s).std() < (arrival_s - taken_s).std() / 3


@pytest.mark.slow
def test_closing_ends_the_program(film: Callable[..., Path]) -> None:
    film(count=100_000)
    with open_source("rpicam:0", live=PATIENT):
        assert any(b"rpicam-vid" in command for command in commands_of_children())
    assert not any(b"rpicam-vid" in command for command in commands_of_children())


def commands_of_children() -> list[bytes]:
    """Return the command line of each process that this one started."""
    pids = [
        pid
        for task in Path("/proc/self/task").glob("*/children")
        for pid in task.read_text().split()
    ]
    return [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in pids]


def test_what_is_not_installed_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(SourceError, match=r"rpicam-vid is not installed: .*install rpicam-apps"):
        open_source("rpicam:0")
    with pytest.raises(SourceError, match=r"install gstreamer1.* nvidia-l4t-gstreamer"):
        open_source("argus:0")
    with pytest.raises(SourceError, match=r"gst: gst-launch-1\.0 is not installed: `sudo"):
        open_source("gst:videotestsrc ! appsink")


def test_gimbal_cameras_and_programs_are_live_and_other_kinds_are_refused_with_a_list() -> None:
    assert all(is_live(f"{kind}:") for kind in (*GIMBALS, "rpicam", "argus", "libcamera", "gst"))
    for wrong in ("cam:0", "ftp://user:secret@host/x", "rtp:5600"):
        assert not is_live(wrong)
        with pytest.raises(
            SourceError, match=r"no such kind of source; there are .*rpicam:"
        ) as told:
            open_source(wrong)
        assert "secret" not in str(told.value)
    with pytest.raises(SourceError, match=r"write rtp://0\.0\.0\.0:PORT"):
        open_source("rtp://0.0.0.0")


@pytest.mark.parametrize(
    ("spec", "asked"),
    [
        ("rtsp://user:secret@10.0.0.1/x", {"size": (640, 480)}),
        ("udp://0.0.0.0:5600", {"rate_hz": 30}),
        ("gst:videotestsrc", {"controls": {"gain": 1}}),
        ("rpicam:0", {"format": "MJPG"}),
    ],
)
def test_what_a_stream_cannot_be_asked_for_is_refused(spec: str, asked: dict[str, Any]) -> None:
    (name,) = asked
    with pytest.raises(SourceError, match=rf"leave camera\.capture\.{name} out") as told:
        open_source(spec, capture=CaptureSettings(**asked))
    assert "secret" not in str(told.value)


def test_a_decoder_that_is_not_there_gives_way_to_the_processor_with_one_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with pytest.raises(SourceError, match=r"capture\.decoder gpu: there are auto, cpu"):
        Decoder("gpu")
    assert Decoder("cpu").hwaccel is None
    with caplog.at_level(logging.WARNING):
        decoder = Decoder("auto")
    if decoder.hwaccel is None:
        (record,) = caplog.records
        assert record.message.startswith("hardware does not decode, the processor does: ")


def gstreamer_has(element: str) -> bool:
    inspect = shutil.which("gst-inspect-1.0")
    return inspect is not None and not subprocess.run([inspect, "--exists", element]).returncode


@pytest.mark.slow
def test_a_gstreamer_pipeline_gives_pictures_with_its_times() -> None:
    if not gstreamer_has("matroskamux"):
        pytest.skip("no GStreamer: gstreamer1.0-tools, gstreamer1.0-plugins-base and -good")
    pipeline = (
        "videotestsrc is-live=true num-buffers=40 ! video/x-raw,format=I420,width=64,height=48"
    )
    with open_source(f"gst:{pipeline},framerate=25/1 ! appsink", live=PATIENT) as source:
        until_connected_again(source)
        frame = source.read()
    assert frame.image.shape == (48, 64, 3)


SERVER = """
import sys, gi
gi.require_version("GstRtspServer", "1.0")
from gi.repository import Gst, GLib, GstRtspServer
Gst.init(None)
server = GstRtspServer.RTSPServer(service=sys.argv[1])
factory = GstRtspServer.RTSPMediaFactory(shared=True)
factory.set_launch("( videotestsrc is-live=true ! video/x-raw,width=96,height=64,framerate=25/1 "
    "! x264enc tune=zerolatency key-int-max=5 ! rtph264pay name=pay0 config-interval=1 )")
server.get_mount_points().add_factory("/live", factory)
server.attach(None)
print("ready", flush=True)
GLib.MainLoop().run()
"""


@contextmanager
def gstreamer_server(port: int) -> Iterator[None]:
    python = "/usr/bin/python3"
    command = [python, "-c", SERVER, str(port)]
    missing = "no RTSP server: gir1.2-gst-rtsp-server-1.0, python3-gi, gstreamer1.0-plugins-ugly"
    if not Path(python).exists() or not gstreamer_has("x264enc"):
        pytest.skip(missing)
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen(command, env={}, **pipes) as process:
        try:
            if process.stdout.readline() != "ready\n":
                pytest.skip(missing)
            yield
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_an_rtsp_server_that_is_killed_and_started_again_is_found_again(
    transport: Any, free_port: FreePort
) -> None:
    port, capture = free_port(), CaptureSettings(transport=transport)
    with gstreamer_server(port):
        address = f"rtsp://127.0.0.1:{port}/live"
        source = open_source(address, live=PATIENT, capture=capture)
        before = source.read()
    with source:
        until(lambda: source.problem)
        with gstreamer_server(port):
            until_connected_again(source)
            after = source.read()
    assert after.image.shape == (64, 96, 3)
    assert after.captured_s > before.captured_s


class Driver:
    """A V4L2 driver as the kernel's headers describe it: formats, sizes, rates, controls."""

    FORMATS = (b"MJPG", b"YUYV")
    SIZES = ((640, 480), (1280, 720))
    RATES = (30, 15)
    CONTROLS = (
        (0x980900, 1, b"Brightness", 0, 255),
        (0x98090C, 2, b"White Balance, Automatic", 0, 1),
        (0x9A0901, 3, b"Auto Exposure", 0, 3),
        (0x9A0902, 1, b"Exposure Time, Absolute", 3, 2047),
    )
    MENU: tuple[bytes | None, ...] = (None, b"Manual Mode", None, b"Aperture Priority Mode")

    def __init__(self) -> None:
        self.values: dict[int, int] = {}

    def __call__(self, _file: int, code: int, data: bytes) -> bytes:
        assert len(data) == code >> 16 & 0x3FFF, "the structure's size is in the ioctl's number"
        found = self._answer(code & 0xFF, data, *struct.unpack_from("=II", data))
        if found is None:
            raise OSError(errno.EINVAL, "Invalid argument")
        return found.ljust(len(data), b"\0")

    def _answer(self, number: int, data: bytes, first: int, second: int) -> bytes | None:
        if number == 2 and first < len(self.FORMATS):
            return struct.pack("=III32s4s", first, second, 0, b"", self.FORMATS[first])
        if number == 74 and first < len(self.SIZES):
            return struct.pack("=I4sIII", first, data[4:8], 1, *self.SIZES[first])
        if number == 75 and first < len(self.RATES):
            return data[:16] + struct.pack("=III", 1, 1, self.RATES[first])
        if number == 36:
            later = [one for one in self.CONTROLS if one[0] > first & ~0x80000000]
            return struct.pack("=II32siiiiI", *later[0], 1, 0, 0) if later else None
        if number == 37 and self.MENU[second] is not None:
            return struct.pack("=II32s", first, second, self.MENU[second])
        if number == 28:
            automatic = self.values.get(0x9A0901) != 1
            if first == 0x9A0902 and automatic:
                raise OSError(errno.EACCES, "Permission denied")
            self.values[first] = second
            return data
        return None


@pytest.fixture
def device(tmp_path: Path) -> Iterator[tuple[v4l2.V4l2Device, Driver]]:
    (tmp_path / "video9").touch()
    driver = Driver()
    with closing(v4l2.V4l2Device(str(tmp_path / "video9"), driver)) as opened:
        yield opened, driver


def test_controls_are_set_by_name_and_what_is_automatic_first(
    device: tuple[v4l2.V4l2Device, Driver],
) -> None:
    camera, driver = device
    camera.set_controls(
        {
            "exposure_time_absolute": 157,
            "auto_exposure": "Manual Mode",
            "white_balance_automatic": False,
        }
    )
    assert driver.values == {0x9A0901: 1, 0x98090C: 0, 0x9A0902: 157}


@pytest.mark.parametrize(
    ("controls", "says"),
    [
        ({"iso": 3}, "no control 'iso'; there are auto_exposure, brightness, exposure_time_abs"),
        ({"brightness": 256}, "brightness is 0 to 255, not 256"),
        ({"brightness": True}, "brightness is 0 to 255, not True"),
        ({"white_balance_automatic": 2}, "white_balance_automatic is true or false, not 2"),
        ({"auto_exposure": "Auto"}, "is manual_mode, aperture_priority_mode, not 'Auto'"),
        ({"exposure_time_absolute": 9}, "cannot be set to 9 .*; is its automatic on"),
    ],
)
def test_other_controls_are_refused_with_what_there_is(
    device: tuple[v4l2.V4l2Device, Driver], controls: dict[str, Any], says: str
) -> None:
    with pytest.raises(SourceError, match=says):
        device[0].set_controls(controls)


@pytest.mark.parametrize(
    ("wanted", "says"),
    [
        ({"format": "H264"}, "no format H264; there are MJPG, YUYV"),
        ({"size": (800, 600)}, "no size 800x600; there are 640x480, 1280x720"),
        ({"rate_hz": 60}, "not 60 frames a second; there are 15, 30"),
        ({"format": "YUYV", "size": (640, 480), "rate_hz": 15}, ""),
    ],
)
def test_what_the_camera_does_not_offer_is_refused_with_what_it_does(
    device: tuple[v4l2.V4l2Device, Driver], wanted: dict[str, Any], says: str
) -> None:
    offered = device[0].formats()
    if not says:
        v4l2.check_offer("camera", offered, CaptureSettings(**wanted))
        return
    with pytest.raises(SourceError, match=says):
        v4l2.check_offer("camera", offered, CaptureSettings(**wanted))


def virtual_camera() -> str:
    """Return a V4L2 device that the kernel itself fills (vivid, v4l2loopback with a writer)."""
    for name in Path("/sys/class/video4linux").glob("video*/name"):
        if name.read_text().startswith("vivid") and "cap" in name.read_text():
            return f"/dev/{name.parent.name}"
    pytest.skip("no virtual camera: sudo modprobe vivid n_devs=1 node_types=0x1")


@pytest.mark.slow
def test_a_v4l2_camera_gives_what_is_asked_with_the_drivers_times() -> None:
    path = virtual_camera()
    capture = CaptureSettings(format="YUYV", size=(640, 360), controls={"brightness": 99})
    clock = MonotonicClock()
    with open_source(path, clock=clock, live=PATIENT, capture=capture) as source:
        frames = [source.read() for _ in range(10)]
        now_s = clock.now()
    assert all(frame is not None and frame.image.shape == (360, 640, 3) for frame in frames)
    captured_s = [frame.captured_s for frame in frames if frame is not None]
    assert np.diff(captured_s).min() > 0
    assert 0 < now_s - captured_s[-1] < 10
    with pytest.raises(SourceError, match="no control 'exposure'; there are"):
        open_source(path, capture=CaptureSettings(controls={"exposure": 1}))


def test_a_silent_address_is_one_line_without_its_password(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("follower_vision.sources.live_source._JOIN_S", 0.1)  # it hangs, as it is to
    settings = LiveSettings(first_frame_s=0.5, retry_s=0.05)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"rtsp://pilot:se@cret@127.0.0.1:{server.getsockname()[1]}/live"
        with pytest.raises(SourceError) as told:
            open_source(address, live=settings)
    assert "rtsp://127.0.0.1:" in str(told.value)
    assert "cret" not in str(told.value)
    assert "\n" not in str(told.value)


def test_a_program_is_ended_with_what_it_has_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PROGRAMS, "shell", ProgramKind("none", "/bin/sh -c {where}"))
    program = CameraProgram("shell", "'sleep 600 & echo $!; wait'", CaptureSettings())
    started = int(program.read(100))
    program.close()

    def lives() -> bool:
        status = Path(f"/proc/{started}/stat")
        return status.exists() and status.read_text("ascii").rpartition(") ")[2][0] != "Z"

    until(lambda: not lives())
