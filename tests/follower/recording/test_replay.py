"""A recorded flight through the real stages again: the same to the last bit, or shown to differ."""

import io
import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from program import FOLLOWER
from rewritten_flight import configured_anew, logged_anew
from rich.console import Console

from follower.apps.inspect import inspect_flight
from follower.apps.replay.comparison import compare, difference, print_comparison
from follower.apps.replay.replay import Replay, replay_settings
from follower.apps.replay.run import DIFFERENT, SAME, replay_flight
from follower.flight.log import FlightLog, SelectionRecord, TrackRecord
from follower.recording import FlightFileError, RecordedFlight, open_flight
from follower.recording.mcap_writer import McapLog
from follower.recording.messages import FrameRecord, messages_of
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.camera_model import CameraModel

FlySmall = Callable[..., Any]
OLD = Path(__file__).parent / "before_processors"


def replayed(flight: RecordedFlight, *overrides: str, **options: Any) -> Replay:
    replay = Replay(flight, replay_settings(flight, overrides), **options)
    replay.run()
    return replay


def test_the_replay_of_a_lossless_flight_is_the_flight(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    replay = replayed(flight)
    assert replay.missed == 0
    compared = compare(flight.log, replay.log)
    assert compared.identical
    assert compared.first_s is None
    assert len(compared.tracks[0].times_s) == len(small_flight.frames)
    assert len(compared.control[0].times_s) == len(small_flight.log.controls)
    assert [event.text for event in replay.log.events] == [
        event.text for event in flight.log.events if event.source == "supervisor"
    ]


@pytest.mark.slow
def test_other_gains_change_the_setpoints_and_nothing_before_them(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    compared = compare(flight.log, replayed(flight, "servo.distance_m=3").log)
    names = {one.name for one in compared.differing}
    assert "asked: forward" in names
    assert not any(name.startswith(("track", "estimate", "state")) for name in names)


def test_another_tracker_changes_the_tracks(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    compared = compare(flight.log, replayed(flight, "tracker=identity").log)
    assert {"track: centre x", "track: produced by"} <= {one.name for one in compared.differing}


def test_the_first_difference_and_its_growth_are_found(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    controls = list(flight.log.controls)
    for step, shift in ((70, 1e-16), (80, 1e-3), (120, 0.5)):
        before = controls[step]
        forward = before.allowed.forward_m_s + shift
        if shift < 1e-9:
            forward = float(np.nextafter(before.allowed.forward_m_s, np.inf))
        controls[step] = replace(before, allowed=replace(before.allowed, forward_m_s=forward))
    altered = FlightLog(flight.log.tracks, controls, flight.log.events)
    (one,) = compare(flight.log, altered).differing
    assert (one.name, one.count) == ("allowed: forward", 3)
    assert one.first_s == controls[70].time_s
    assert 0 < one.largest_until(controls[79].time_s) < 1e-15
    assert one.largest_until(controls[100].time_s) == pytest.approx(1e-3)
    assert one.largest == pytest.approx(0.5)


def test_nan_equals_nan_and_zero_equals_minus_zero_and_none_equals_none_alone() -> None:
    nan, infinity = float("nan"), float("inf")
    assert difference(nan, nan) == difference(0.0, -0.0) == difference(None, None) == 0
    assert difference(infinity, infinity) == 0
    assert difference(nan, 1.0) == difference(infinity, 1.0) == difference(None, 1.0) == infinity
    assert difference(np.eye(2), np.eye(2)) == 0
    assert difference(np.eye(2), 3 * np.eye(2)) == 2
    assert difference(np.eye(2), None) == difference(None, np.eye(2)) == infinity


def test_what_one_side_lacks_has_no_amount(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    controls = list(flight.log.controls)
    controls[70] = replace(controls[70], estimate=None)
    altered = FlightLog(flight.log.tracks, controls, flight.log.events)
    printed = Console(file=io.StringIO(), width=120)
    print_comparison(printed, "Control", compare(flight.log, altered).control)
    said = printed.file.getvalue()
    assert "azimuth" in said
    assert "missing" in said
    assert " rad" not in said


@pytest.mark.slow
def test_without_control_steps_control_is_not_said_to_replay(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = open_flight(small_flight.folder)
    kept = (FrameRecord, SelectionRecord, TrackRecord)
    config = flight.config.to_yaml().replace("video: lossless", "video: h264")
    folder = Path(shutil.copytree(small_flight.folder, tmp_path / "flight"))
    (folder / "config.yaml").write_text(config, "utf-8")
    (folder / "flight.mcap").unlink()
    with McapLog(folder / "flight.mcap", flight.config.epoch_ns, config) as log:
        for time_s, message in flight.messages():
            if isinstance(message, kept):
                log.write(message, time_s)
    assert replay_flight(folder, out=tmp_path) == SAME
    said = " ".join(capsys.readouterr().out.split())
    assert "Control replays" not in said
    assert "Control from the recorded tracks: 0 compared Vision" in said
    assert "There was no control step to compare. Vision was not compared strictly" in said


def test_control_replays_from_the_recorded_tracks_without_any_video(
    small_flight: Any, tmp_path: Path
) -> None:
    folder = tmp_path / "flight"
    shutil.copytree(small_flight.folder, folder, ignore=shutil.ignore_patterns("video.mkv"))
    flight = open_flight(folder)
    replay = replayed(flight, tracks_recorded=True)
    assert compare(flight.log, replay.log).identical
    assert replay_flight(folder, out=tmp_path / "runs") == SAME


@pytest.mark.slow
def test_lossy_video_replays_control_exactly_and_its_saved_replay_wholly(
    fly_small: FlySmall, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fly_small(tmp_path / "lossy", video="h264")
    runs = tmp_path / "runs"
    assert replay_flight(tmp_path / "lossy", save=True, out=runs) == SAME
    said = " ".join(capsys.readouterr().out.split())
    assert "Control replays bit for bit" in said
    assert "the video is lossy" in said
    assert (runs / "replay-lossy" / "replay.png").stat().st_size > 10_000
    reference = runs / "lossy-replayed"
    assert replay_flight(reference, out=runs) == SAME
    assert "identical to the flight, bit for bit" in " ".join(capsys.readouterr().out.split())
    one, two = open_flight(tmp_path / "lossy"), open_flight(reference)
    assert two.frames == one.frames
    assert len(two.log.controls) == len(one.log.controls)
    assert two.remarks == []
    assert [p.data for p in two.packets()] == [p.data for p in one.packets()]


@pytest.mark.slow
def test_a_flight_whose_code_has_changed_since_is_found_to_differ(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Here the recorded settings are altered behind the recording's back."""

    def edit(config: dict[str, Any]) -> None:
        config["settings"]["envelope"]["max_jerk_m_s3"] = 9.9

    folder = configured_anew(small_flight.folder, tmp_path / "flight", edit)
    assert replay_flight(folder, out=tmp_path / "runs") == DIFFERENT
    said = " ".join(capsys.readouterr().out.split())
    assert "The replay differs from the flight" in said
    assert "The first difference is at" in said
    assert "allowed: forward" in said
    assert (tmp_path / "runs" / "replay-flight" / "setpoints.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "why"),
    [
        (lambda config: config["processor"].update(features="NEON"), "recorded with NEON"),
        (lambda config: config["processor"].update(blas="Z80"), "recorded with Z80"),
        (lambda config: config["versions"].update(numpy="1.0"), "recorded with 1.0"),
        (lambda config: config["versions"].update(libc="musl 9"), "recorded with musl 9"),
        (lambda config: config["versions"].update(machine="aarch64"), "recorded with aarch64"),
        (lambda config: config.pop("processor"), "the recording does not name its processor"),
    ],
)
def test_elsewhere_control_is_compared_within_a_tolerance_and_it_says_why(
    small_flight: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    edit: Callable[[dict[str, Any]], None],
    why: str,
) -> None:
    folder = configured_anew(small_flight.folder, tmp_path / "flight", edit)
    assert replay_flight(folder, out=tmp_path / "runs") == SAME
    said = " ".join(capsys.readouterr().out.split())
    assert "Compared within 1e-09: " in said
    assert why in said
    assert "Control replays within 1e-09. Vision was not compared strictly: a tracker's" in said


@pytest.mark.slow
def test_another_version_of_this_program_and_another_model_are_the_same_kind(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def edit(config: dict[str, Any]) -> None:
        config["versions"]["drone-target-follower"] = "0.0.1"
        config["processor"]["model"] = "Another Name"

    folder = configured_anew(small_flight.folder, tmp_path / "flight", edit)
    assert replay_flight(folder, out=tmp_path / "runs") == SAME
    assert "Compared bit for bit: " in capsys.readouterr().out


@pytest.mark.slow
def test_elsewhere_more_than_rounding_is_a_difference(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def edit(config: dict[str, Any]) -> None:
        config["processor"]["features"] = "NEON"
        config["settings"]["envelope"]["max_jerk_m_s3"] = 9.9999999

    folder = configured_anew(small_flight.folder, tmp_path / "flight", edit)
    assert replay_flight(folder, out=tmp_path / "runs") == DIFFERENT
    said = " ".join(capsys.readouterr().out.split())
    assert "The replay differs from the flight" in said
    assert "Compared within 1e-09: processor features" in said


@pytest.mark.slow
def test_a_flight_from_before_recordings_named_their_processor_opens_replays_and_reports(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of it there are log and settings; its control multiplied its matrices by BLAS."""
    flight = open_flight(OLD)
    assert replay_settings(flight).envelope.max_yaw_jerk_deg_s3 is None  # no limit in those days
    assert flight.config.processor == {}
    compared = compare(flight.log, replayed(flight, tracks_recorded=True).log)
    assert compared.agrees(1e-9)
    assert not compared.agrees(0.0)
    assert replay_flight(OLD, out=tmp_path) == SAME
    said = " ".join(capsys.readouterr().out.split())
    assert "952 compared, the same within 1e-09 (the largest difference is" in said
    assert "Compared within 1e-09: the recording does not name its processor." in said
    assert "Control replays within 1e-09. Vision was not replayed." in said
    report = inspect_flight(OLD, tmp_path / "report.html", Console(quiet=True))
    assert "not recorded" in report.read_text("utf-8")


def test_a_setting_that_there_is_not_is_refused_before_anything_is_said(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SettingsError, match="distance"):
        replay_flight(OLD, ["servo.distance=3"])
    assert capsys.readouterr().out == ""


@pytest.mark.slow
def test_with_other_settings_the_replay_is_labelled_open_loop(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, overrides = small_flight.folder, ["servo.distance_m=3"]
    assert replay_flight(folder, overrides, save=True, out=tmp_path) == SAME
    assert "Open loop" in capsys.readouterr().out
    saved = open_flight(tmp_path / f"{small_flight.folder.name}-replayed")
    assert saved.config.run["open_loop"] == "replayed with servo.distance_m=3"
    replay_flight(saved.folder, ["servo.distance_m=4"], save=True, out=tmp_path)
    again = open_flight(tmp_path / f"{saved.folder.name}-replayed")
    said = "replayed with servo.distance_m=3, replayed with servo.distance_m=4"
    assert again.config.run["open_loop"] == said


@pytest.mark.slow
def test_a_saved_replay_whose_video_lacks_frames_replays_again(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def left_out(message: object) -> object:
        if isinstance(message, FrameRecord) and message.sequence in (20, 21):
            return replace(message, video_index=None)
        return message

    logged_anew(small_flight.folder, tmp_path / "flight", left_out)
    for name in ("flight", "flight-replayed"):
        assert replay_flight(tmp_path / name, save=name == "flight", out=tmp_path) == SAME
        said = " ".join(capsys.readouterr().out.split())
        assert "Vision was not compared strictly: 2 frames are not in the video." in said


@pytest.mark.slow
@pytest.mark.parametrize("content", [b"", b"no video" * 99, None])
def test_without_a_video_that_can_be_read_control_is_replayed_and_that_is_said(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None
) -> None:
    folder = Path(shutil.copytree(small_flight.folder, tmp_path / "flight"))
    if content is None:
        (folder / "video.mkv").unlink()
    else:
        (folder / "video.mkv").write_bytes(content)
    assert replay_flight(folder, out=tmp_path) == SAME
    out = capsys.readouterr().out
    assert "video.mkv cannot be read (" in out
    assert "Control replays bit for bit. Vision was not replayed." in out
    with pytest.raises(FlightFileError, match="--save needs the video"):
        replay_flight(folder, save=True, out=tmp_path)


def test_a_log_with_nothing_in_it_is_no_replay_that_succeeded(
    small_flight: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(small_flight.folder, tmp_path / "flight"))
    (folder / "flight.mcap").write_bytes((folder / "flight.mcap").read_bytes()[:100])
    config, camera = folder / "config.yaml", asdict(CameraModel.from_fov(160, 120, 1.2))
    known = {
        **yaml.safe_load(config.read_text("utf-8")),
        "camera": {**camera, "distortion": [0] * 5},
    }
    config.write_text(yaml.safe_dump(known), "utf-8")
    assert replay_flight(folder, out=tmp_path) == DIFFERENT
    assert "There was nothing to compare." in capsys.readouterr().out


def test_a_log_that_contradicts_itself_is_named(small_flight: Any) -> None:
    flight = open_flight(small_flight.folder)
    kinds = ("TrackRecord",)
    flight._messages = [
        (time_s, message)
        for time_s, message in flight._messages
        if type(message).__name__ not in kinds
    ]
    with pytest.raises(FlightFileError, match="used the track of frame"):
        replayed(flight)


def test_a_control_step_is_written_in_parts_that_end_with_the_step(small_flight: Any) -> None:
    names = [type(part).__name__ for part in messages_of(small_flight.log.controls[-1])]
    assert names == [
        *("Attitude", "Attitude", "VehicleState", "SupervisorInputs", "TargetEstimate"),
        *("SetpointRecord", "StepRecord"),
    ]


@pytest.mark.slow
def test_the_command_replays_in_another_process(small_flight: Any, tmp_path: Path) -> None:
    """Another process, other addresses in memory, other hash seeds: the same bits."""
    command = (*FOLLOWER, "replay")
    done = subprocess.run(
        [*command, str(small_flight.folder), "--out", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "identical to the flight, bit for bit" in " ".join(done.stdout.split())
    missing = subprocess.run([*command, str(tmp_path)], capture_output=True, text=True, check=False)
    assert missing.returncode == 2
    assert missing.stderr.startswith("follower: ")
    assert missing.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a$_$b", os.fsdecode(b"caf\xe9")])
def test_a_folder_of_an_odd_name_replays_and_reports(
    small_flight: Any, tmp_path: Path, name: str
) -> None:
    """As TeX would have it, or in another encoding than UTF-8."""
    folder = Path(shutil.copytree(small_flight.folder, tmp_path / name))
    assert replay_flight(folder, ["servo.distance_m=3"], out=tmp_path) == SAME
    assert (tmp_path / f"replay-{name}" / "replay.png").stat().st_size > 10_000
    assert inspect_flight(folder, console=Console(quiet=True)).read_text("utf-8")
