"""Logs that are cut, foreign, newer or wrong: what can be read is read, the rest is said."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from follower.recording import FlightFileError, open_flight
from follower.recording.mcap_writer import METADATA, PROFILE
from follower.recording.video_reader import video_problem

CLUSTER = bytes.fromhex("1f43b675")
"""Matroska's mark of a cluster: some 400 ms of pictures."""


def copied(flight: Any, folder: Path) -> Path:
    shutil.copytree(flight.folder, folder)
    return folder


def refusal(folder: Path) -> str:
    """Why a folder is not opened, in one line."""
    with pytest.raises(FlightFileError) as error:
        open_flight(folder)
    text = str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize("share", [0.001, 0.2, 0.5, 0.9, 0.99, 0.9999])
def test_a_cut_log_is_read_up_to_the_cut(small_flight: Any, tmp_path: Path, share: float) -> None:
    folder = copied(small_flight, tmp_path / "flight")
    path = folder / "flight.mcap"
    whole = path.read_bytes()
    path.write_bytes(whole[: round(share * len(whole))])
    flight = open_flight(folder)
    assert any("cut off" in remark for remark in flight.remarks)
    times = [record.time_s for record in flight.log.controls]
    assert times == [record.time_s for record in small_flight.log.controls[: len(times)]]
    if share < 0.1:
        assert not times


@pytest.mark.slow
def test_the_further_the_log_goes_the_more_is_read(small_flight: Any, tmp_path: Path) -> None:
    """At every cut: never an error, never less than at an earlier cut."""
    folder = copied(small_flight, tmp_path / "flight")
    path = folder / "flight.mcap"
    whole = path.read_bytes()
    counts = []
    for length in range(64, len(whole), len(whole) // 40):
        path.write_bytes(whole[:length])
        counts.append(len(open_flight(folder).log.controls))
    assert counts == sorted(counts)
    assert counts[-1] == len(small_flight.log.controls)


def test_damaged_bytes_end_the_log_there(small_flight: Any, tmp_path: Path) -> None:
    folder = copied(small_flight, tmp_path / "flight")
    path = folder / "flight.mcap"
    data = bytearray(path.read_bytes())
    for place in range(len(data) // 2, len(data) // 2 + 40):
        data[place] ^= 0x55
    path.write_bytes(data)
    flight = open_flight(folder)
    assert any("damaged" in remark for remark in flight.remarks)
    assert 0 < len(flight.log.controls) < len(small_flight.log.controls)


def test_a_cut_video_gives_the_pictures_before_the_cut(small_flight: Any, tmp_path: Path) -> None:
    folder = copied(small_flight, tmp_path / "flight")
    path = folder / "video.mkv"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    flight = open_flight(folder)
    pictures = list(flight.pictures())
    assert 10 < len(pictures) < len(small_flight.frames)
    assert any("video.mkv ends after" in remark for remark in flight.remarks)


def test_damage_in_a_videos_description_costs_no_picture(small_flight: Any, tmp_path: Path) -> None:
    folder = copied(small_flight, tmp_path / "flight")
    path = folder / "video.mkv"
    path.write_bytes(path.read_bytes().replace(b"Lavf", b"\xe9avf"))
    assert video_problem(path) is None
    assert len(list(open_flight(folder).pictures())) == len(small_flight.frames)


@pytest.mark.slow
def test_damage_inside_a_video_costs_the_pictures_there_and_no_other_is_taken_for_them(
    small_flight: Any, tmp_path: Path
) -> None:
    """A cluster of the video is made unreadable; what follows it is what it was."""
    folder = copied(small_flight, tmp_path / "flight")
    path = folder / "video.mkv"
    data = bytearray(path.read_bytes())
    places = [place for place in range(len(data)) if data[place : place + 4] == CLUSTER]
    data[places[len(places) // 3]] ^= 0xFF
    path.write_bytes(data)
    right = {frame.sequence: frame.image for frame in open_flight(small_flight.folder).pictures()}
    flight = open_flight(folder)
    pictures = list(flight.pictures())
    numbers = [frame.sequence for frame in pictures]
    assert 20 < len(pictures) < len(right)
    assert numbers[-1] == max(right)
    assert all(np.array_equal(frame.image, right[frame.sequence]) for frame in pictures)
    lost = len(right) - len(pictures)
    assert f"video.mkv misses {lost} of its {len(right)} pictures." in flight.remarks


def test_a_folder_that_is_no_flight_says_what_is_there(small_flight: Any, tmp_path: Path) -> None:
    assert "no such folder" in refusal(tmp_path / "nowhere")
    assert "flight.mcap is missing" in refusal(tmp_path)
    folder = copied(small_flight, tmp_path / "flight")
    (folder / "flight.mcap").unlink()
    assert "only config.yaml, mavlink.tlog, video.mkv" in refusal(folder)


@pytest.mark.parametrize("content", [b"", b"x", b"PK\x03\x04 a zip, not a log" * 9, b"\0" * 99])
def test_another_kind_of_file_is_no_log(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "flight.mcap").write_bytes(content)
    assert "not in the MCAP format" in refusal(tmp_path)


def write_foreign(path: Path, profile: str, metadata: dict[str, str] | None) -> None:
    writer: Any = Writer(str(path), compression=CompressionType.NONE)
    writer.start(profile, "somebody else 2.0")
    if metadata is not None:
        writer.add_metadata(METADATA, metadata)
    schema = writer.register_schema("a", "jsonschema", b"{}")
    channel = writer.register_channel("/vision/track", "json", schema)
    other = writer.register_channel("/more", "json", schema)
    for number in range(3):
        writer.add_message(other, number, b"{}", number)
    if metadata is None:
        writer.add_message(channel, 5, json.dumps({"sequence": 1}).encode(), 5)
    writer.finish()


def test_a_log_of_another_program_is_named(tmp_path: Path) -> None:
    write_foreign(tmp_path / "flight.mcap", "ros2", None)
    text = refusal(tmp_path)
    assert "somebody else 2.0" in text
    assert "'ros2'" in text


def test_a_newer_format_is_refused_and_says_what_can_be_read(tmp_path: Path) -> None:
    newer = {"format": "7", "epoch_ns": "0", "config": ""}
    write_foreign(tmp_path / "flight.mcap", PROFILE, newer)
    text = refusal(tmp_path)
    assert "format 7" in text
    assert "mavlink.tlog and video.mkv can be read" in text


def test_messages_that_nobody_knows_are_passed_over_and_counted(
    small_flight: Any, tmp_path: Path
) -> None:
    config = (small_flight.folder / "config.yaml").read_text()
    known = {"format": "1", "epoch_ns": "0", "config": config}
    write_foreign(tmp_path / "flight.mcap", PROFILE, known)
    flight = open_flight(tmp_path)
    assert flight.remarks == ["flight.mcap: 3 messages of '/more' were passed over."]
    assert flight.config.settings == open_flight(small_flight.folder).config.settings


def test_a_message_that_does_not_fit_names_its_topic(tmp_path: Path) -> None:
    write_foreign(tmp_path / "flight.mcap", PROFILE, None)
    text = refusal(tmp_path)
    assert "a message of /vision/track cannot be read" in text
    assert "the 0 messages before it, up to 0.00 s, could be" in text
    assert "mavlink.tlog and video.mkv can be read" in text


@pytest.mark.parametrize("key", ["format", "epoch_ns", "config"])
def test_a_log_that_does_not_know_itself_says_so(tmp_path: Path, key: str) -> None:
    known = {"format": "1", "epoch_ns": "0", "config": ""}
    write_foreign(tmp_path / "flight.mcap", PROFILE, {k: known[k] for k in known if k != key})
    assert f"what the log says of itself is damaged (KeyError('{key}'))" in refusal(tmp_path)


def test_without_its_configuration_file_the_log_still_knows_it(
    small_flight: Any, tmp_path: Path
) -> None:
    folder = copied(small_flight, tmp_path / "flight")
    (folder / "config.yaml").unlink()
    assert open_flight(folder).config == open_flight(small_flight.folder).config


GOOD = "kind: simulated\nsettings: {}\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"format: [1",
        b"\xff\xfe\x00",
        b"kind: simulated\nmore: 1",
        *(
            f"{GOOD}{line}".encode()
            for line in ("run: 5", "run: null", "versions: 3", "models: [1]", "format: x")
        ),
        *(f"{GOOD}{line}".encode() for line in ("epoch_ns: abc", "format: 99", "camera: {fx: 1}")),
        b"kind: simulated\nsettings: null",
        b"kind: 7\nsettings: {}",
    ],
)
def test_a_broken_configuration_is_taken_from_the_log(
    small_flight: Any, tmp_path: Path, content: bytes
) -> None:
    """As a power cut may leave it."""
    folder = copied(small_flight, tmp_path / "flight")
    (folder / "config.yaml").write_bytes(content)
    flight = open_flight(folder)
    assert flight.config == open_flight(small_flight.folder).config
    (remark,) = flight.remarks
    assert "config.yaml: " in remark
    assert "taken is its copy in flight.mcap" in remark


@pytest.mark.parametrize("how", ["cut", "another flight's", "a folder"])
def test_a_configuration_that_is_not_the_logs_is_told_and_not_taken(
    small_flight: Any, tmp_path: Path, how: str
) -> None:
    """What is left of a file that was cut is whole YAML, with defaults for what it lacks."""
    folder = copied(small_flight, tmp_path / "flight")
    path = folder / "config.yaml"
    text = path.read_text("utf-8")
    path.unlink()
    if how == "a folder":
        path.mkdir()
    else:
        cut = text[: text.index("  servo:")]
        path.write_text(cut if how == "cut" else text.replace("kind: simulated", "kind: video"))
    flight = open_flight(folder)
    assert flight.config == open_flight(small_flight.folder).config
    why = "Is a directory" if how == "a folder" else "not as it was recorded"
    assert flight.remarks == [f"{path}: {why}; taken is its copy in flight.mcap."]


@pytest.mark.parametrize("config", [None, b"format: [1"])
def test_no_configuration_at_all_is_named(
    small_flight: Any, tmp_path: Path, config: bytes | None
) -> None:
    folder = tmp_path / "flight"
    folder.mkdir()
    data = (small_flight.folder / "flight.mcap").read_bytes()
    (folder / "flight.mcap").write_bytes(data[:100])
    if config is not None:
        (folder / "config.yaml").write_bytes(config)
    text = refusal(folder)
    assert "config.yaml: missing" in text or "config.yaml: not a flight's configuration" in text
    assert "of flight.mcap 0 messages could be read" in text


def what_is_said(folder: Path) -> list[str]:
    """The remarks on a flight, or why there is none."""
    try:
        return open_flight(folder).remarks
    except FlightFileError as error:
        return [str(error)]


@pytest.mark.slow
def test_damage_anywhere_is_a_remark_or_a_line(small_flight: Any, tmp_path: Path) -> None:
    """Bytes at random, most of them where no checksum guards them: at the beginning."""
    folder = copied(small_flight, tmp_path / "flight")
    (folder / "config.yaml").unlink()
    whole, rng = (folder / "flight.mcap").read_bytes()[:60_000], np.random.default_rng(5)
    for trial in range(60):
        data = bytearray(whole)
        for place in rng.integers(0, (200, 5_000, len(data))[trial % 3], 3):
            data[place] = rng.integers(0, 256)
        (folder / "flight.mcap").write_bytes(data)
        said = what_is_said(folder)
        assert any("flight.mcap" in line for line in said)
        assert not any("\n" in line for line in said)


def test_a_flight_without_video_says_so(small_flight: Any, tmp_path: Path) -> None:
    folder = copied(small_flight, tmp_path / "flight")
    (folder / "video.mkv").unlink()
    flight = open_flight(folder)
    with pytest.raises(FlightFileError, match="the flight has no video; its log can be read"):
        list(flight.pictures())
    (folder / "video.mkv").write_bytes(b"no video at all" * 50)
    with pytest.raises(FlightFileError, match="the video cannot be read"):
        list(flight.pictures())
