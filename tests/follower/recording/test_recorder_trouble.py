"""A slow disk, a full disk, a power cut: the flight goes on, and what was written can be read."""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from follower.flight.log import DetectionRecord, TrackRecord
from follower.recording import (
    FlightConfig,
    RecordedFlight,
    Recorder,
    RecorderSettings,
    VideoKind,
    append_file,
    open_flight,
)
from follower.recording.append_file import AppendFile, BacklogError
from follower.settings.settings import Settings
from follower_vision.clock import MonotonicClock, SimulatedClock
from follower_vision.detection import Detection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame

PROGRAM = Path(__file__).with_name("record_until_killed.py")
IMAGE = np.random.default_rng(1).integers(0, 255, (240, 320, 3), dtype=np.uint8)


def start(folder: Path, *arguments: str, **options: Any) -> subprocess.Popen[str]:
    command = [sys.executable, str(PROGRAM), str(folder), *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_killed_process_leaves_files_that_open_up_to_the_last_second(
    tmp_path: Path, seed: int
) -> None:
    kind = ("h264", "lossless")[seed % 2]
    with start(tmp_path, kind) as process:
        assert process.stdout is not None
        wait_s, last_s = random.Random(seed).uniform(1.2, 3.0), 0.0
        while last_s < wait_s:
            late_s, last_s = map(float, process.stdout.readline().split())
        os.kill(process.pid, signal.SIGKILL)
        for line in process.stdout:
            late_s, last_s = map(float, line.split())
    flight, least_s = open_flight(tmp_path), last_s - 1.0 - late_s
    assert flight.log.controls[-1].time_s > least_s
    assert flight.frames[-1].captured_s > least_s
    assert list(flight.packets())[-1].time_s > least_s
    pictures = list(flight.pictures())
    assert pictures[-1].captured_s > least_s
    assert [picture.sequence for picture in pictures] == list(range(len(pictures)))
    assert any("cut off" in remark for remark in flight.remarks)


def test_a_log_can_be_read_from_its_first_moment(tmp_path: Path) -> None:
    """However late the recorder's thread comes to write."""
    recorder = Recorder(tmp_path, FlightConfig.of("real", Settings()), SimulatedClock())
    shutil.copytree(tmp_path, tmp_path.with_name("killed"))
    recorder.close()
    flight = open_flight(tmp_path.with_name("killed"))
    assert flight.config == open_flight(tmp_path).config
    assert flight.log.controls == []


def fly(folder: Path, seconds: float, settings: RecorderSettings) -> tuple[Recorder, list[float]]:
    """Hand over frames and events in real time; return how long each hand-over took."""
    clock, took = MonotonicClock(), []
    with Recorder(folder, FlightConfig.of("real", Settings()), clock, settings) as recorder:
        number = 0
        while (now_s := clock.now()) < seconds or not took:
            began = time.perf_counter()
            recorder.add_frame(Frame(IMAGE, now_s, number), now_s)
            recorder.log.note(now_s, "test", f"frame {number}")
            took.append(time.perf_counter() - began)
            number += 1
            clock.sleep_until(number / 60)
    return recorder, took


@pytest.mark.slow
def test_a_slow_disk_costs_frames_of_the_video_but_no_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that needs half a second for each write: nobody waits for it."""
    sync = os.fdatasync

    def slow(descriptor: int) -> None:
        time.sleep(0.5)
        sync(descriptor)

    monkeypatch.setattr(os, "fdatasync", slow)
    settings = RecorderSettings(buffer_mb=2.0, keep_free_mb=0)
    recorder, took = fly(tmp_path, 2.5, settings)
    assert np.median(took) < 0.1  # a fifth of one write: nobody waited for it
    flight = open_flight(tmp_path)
    notes = [event for event in flight.log.events if event.source == "test"]
    assert len(notes) == len(took)
    missing = [frame for frame in flight.frames if frame.video_index is None]
    assert missing
    assert any("left out" in remark for remark in recorder.remarks)
    assert any("left out" in event.text for event in flight.log.events)
    pictures = list(flight.pictures())
    assert len(pictures) == len(flight.frames) - len(missing)
    assert flight.remarks == []


@pytest.mark.slow
def test_waiting_frames_take_bounded_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = threading.Event()
    settings = RecorderSettings(buffer_mb=1.0, keep_free_mb=0)
    config = FlightConfig.of("real", Settings())
    recorder = Recorder(tmp_path, config, MonotonicClock(), settings)
    monkeypatch.setattr(os, "fdatasync", lambda _: blocked.wait(20))
    deadline = time.monotonic() + 2.0
    while time.monotonic() < deadline:
        recorder.add_frame(Frame(IMAGE, 0.0, 0), 0.0)
        time.sleep(0.002)
    video = recorder._video
    assert video._waiting_bytes <= 1e6 + IMAGE.nbytes
    assert video.left_out > 50
    blocked.set()
    recorder.close()


def test_a_log_that_has_fallen_behind_is_put_onto_the_disk_in_small_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the disk fills meanwhile, no more than one part is missing."""
    sync, lengths = os.fdatasync, [0]

    def measured(descriptor: int) -> None:
        sync(descriptor)
        lengths.append(os.fstat(descriptor).st_size)

    settings = RecorderSettings(video=VideoKind.NONE)
    with Recorder(tmp_path, FlightConfig.of("real", Settings()), MonotonicClock(), settings) as one:
        monkeypatch.setattr(os, "fdatasync", measured)
        for number in range(3000):
            one.log.note(number / 50, "test", f"a note of some length, number {number}")
    parts = np.diff(lengths)
    assert len(parts) >= 3000 / 200
    assert parts[1:].max() < 60_000
    assert len(open_flight(tmp_path).log.events) >= 3000


@pytest.mark.slow
def test_when_the_disk_gets_full_the_video_ends_first(tmp_path: Path) -> None:
    free_mb = shutil.disk_usage(tmp_path).free / 1e6
    settings = RecorderSettings(keep_free_mb=2 * free_mb)
    recorder, _ = fly(tmp_path, 1.5, settings)
    flight = open_flight(tmp_path)
    assert any("the video ends here" in remark for remark in recorder.remarks)
    notes = [event.time_s for event in flight.log.events if event.source == "test"]
    assert notes[-1] > 1.4
    pictures = list(flight.pictures())
    assert 0 < len(pictures) < len(flight.frames)


def limit_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))


@pytest.mark.slow
def test_files_that_must_not_grow_end_the_recording_but_not_the_flight(tmp_path: Path) -> None:
    """The kernel refuses writes beyond 150 kB a file: first the video's, then the log's."""
    process = start(tmp_path, "h264", "3", stderr=subprocess.PIPE, preexec_fn=limit_files)
    output, said = process.communicate(timeout=60)
    assert process.returncode == 0
    assert float(output.split()[-1]) > 2.9
    video, *log = said.strip().splitlines()
    assert f"the video ends here: File too large ({tmp_path / 'video.mkv'}, " in video
    assert "MB free" in video
    assert all("the log stops here" in line for line in log)
    assert len(log) <= 1  # one warning each
    flight = open_flight(tmp_path)
    assert flight.log.controls
    assert list(flight.pictures())
    assert any("the video ends here" in event.text for event in flight.log.events)


def test_a_file_keeps_its_last_whole_piece_when_the_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    with AppendFile(path) as file:
        file.write(b"one")
        file.commit()
        write = os.write

        def full(descriptor: int, data: Any) -> int:
            if len(data) > 2:
                return write(descriptor, data[:2])
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(append_file, "write_some", full)
        file.write(b"four")
        with pytest.raises(OSError, match="No space"):
            file.commit()
        assert path.read_bytes() == b"one"
        monkeypatch.setattr(append_file, "write_some", write)
        file.write(b"five")
        file.commit()
        assert path.read_bytes() == b"onefourfive"
        assert file.tell() == 11


def test_what_waits_for_a_full_disk_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_descriptor: int, _data: Any) -> int:
        raise OSError(28, "No space left on device")

    with AppendFile(tmp_path / "file") as file:
        monkeypatch.setattr(append_file, "write_some", full)
        for _ in range(16):
            file.write(bytes(1_000_000))
        with pytest.raises(OSError, match="No space"):
            file.commit()
        file.write(b"x")
        with pytest.raises(BacklogError):
            file.commit()


@pytest.mark.slow
def test_a_log_that_could_not_be_written_for_a_while_misses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, full = os.write, threading.Event()

    def sometimes(descriptor: int, data: Any) -> int:
        if full.is_set():
            raise OSError(28, "No space left on device")
        return write(descriptor, data)

    monkeypatch.setattr(append_file, "write_some", sometimes)
    settings = RecorderSettings(video=VideoKind.NONE)
    clock = MonotonicClock()
    with Recorder(tmp_path, FlightConfig.of("real", Settings()), clock, settings) as recorder:
        for number in range(50):
            (full.set if 10 <= number < 30 else full.clear)()
            recorder.log.note(clock.now(), "test", str(number))
            clock.sleep_until(clock.now() + 0.04)
    flight: RecordedFlight = open_flight(tmp_path)
    notes = [event.text for event in flight.log.events if event.source == "test"]
    assert notes == [str(number) for number in range(50)]
    (stopped, again) = recorder.remarks
    assert "waits in memory" in stopped
    assert str(tmp_path / "flight.mcap") in stopped
    assert "MB free" in stopped
    assert "written again" in again


def test_a_codec_that_is_not_there_ends_the_video_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("follower.recording.video_writer._LOSSY_CODEC", "libx264nowhere")
    recorder, took = fly(tmp_path, 0.5, RecorderSettings(keep_free_mb=0))
    assert any("the video ends here" in remark for remark in recorder.remarks)
    notes = [event for event in open_flight(tmp_path).log.events if event.source == "test"]
    assert len(notes) == len(took)


KEPT = 10
TRACKS = 95


def test_memory_keeps_the_newest_and_the_recording_keeps_all(tmp_path: Path) -> None:
    config = FlightConfig.of("simulated", Settings())
    with Recorder(tmp_path, config, SimulatedClock(), threaded=False, kept=KEPT) as recorder:
        for number in range(TRACKS):
            recorder.log.add_track(TrackRecord(None, number, 0.1 * number, 0.0, 0.0, 0.0))
            held = [record.sequence for record in recorder.log.tracks]
            assert held[-1] == number
            assert min(number + 1, KEPT) <= len(held) <= 2 * KEPT
            assert held == list(range(held[0], number + 1))
    assert [record.sequence for record in open_flight(tmp_path).log.tracks] == list(range(TRACKS))


def test_what_cannot_be_written_is_left_out_and_the_rest_is_there(tmp_path: Path) -> None:
    """As the answer of a detector of another package, or a file's name that is no UTF-8."""
    config = FlightConfig.of("simulated", Settings())
    odd = Detection(Box(1, 2, 3, 4), "person", "person", 0.5)  # type: ignore[arg-type]
    with Recorder(tmp_path, config, MonotonicClock()) as recorder:
        for number in range(TRACKS):
            recorder.log.note(0.1 * number, "operator", os.fsdecode(b"stop \xe9"))
            recorder.log.pass_on(
                DetectionRecord(number, 0.1 * number, number, (odd,)), 0.1 * number
            )
    (remark,) = recorder.remarks
    assert "left out what cannot be written, DetectionRecord" in remark
    flight = open_flight(tmp_path)
    assert [one.text for one in flight.log.events].count("stop ?") == TRACKS
    assert not flight.detections


def test_what_is_said_does_not_fill_the_memory_either(tmp_path: Path) -> None:
    config = FlightConfig.of("simulated", Settings())
    with Recorder(tmp_path, config, SimulatedClock(), threaded=False, kept=KEPT) as recorder:
        for number in range(TRACKS):
            recorder.log.note(0.1 * number, "operator", f"stop, by {number}")
        assert recorder.log.events[-1].text == f"stop, by {TRACKS - 1}"
        assert len(recorder.log.events) <= 2 * KEPT
    assert len(open_flight(tmp_path).log.events) == TRACKS
