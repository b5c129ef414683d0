"""Recordings of other drones and cameras become flights that every command opens."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_recordings import (
    FOV_DEG,
    LATITUDE,
    LONGITUDE,
    RATE_HZ,
    gopro_payload,
    klv_packet,
    pictures,
    subtitles,
    write_video,
    yaw_rad,
    yaw_rate_rad_s,
)

from follower.apps.main import main
from follower.recording import RecordedFlight, open_flight
from follower.recording.telemetry_logs import read_telemetry

SECONDS = 8.0
ROOM = "--set", "recorder.keep_free_mb=1"
LATE_S = 0.3
"""Telemetry tells how the camera was turned that much earlier."""
PITCH_DEG = -4.0


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the program as the command line does; return its exit code."""
    monkeypatch.setattr(sys, "argv", ["follower", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    return int(end.value.code or 0)


def imported(monkeypatch: pytest.MonkeyPatch, out: Path, *arguments: object) -> RecordedFlight:
    assert run(monkeypatch, "import", *arguments, "-o", out, *ROOM) == 0
    (folder,) = out.iterdir()
    return open_flight(folder)


def attitudes_of(flight: RecordedFlight) -> np.ndarray:
    rows = [(a.time_s, *a.numbers) for c in flight.log.controls for a in c.attitudes]
    return np.array(rows).reshape(-1, 7)


def dji_lines(time_s: float) -> str:
    place = f"[latitude: {LATITUDE + 1e-5 * time_s:.6f}] [longitude: {LONGITUDE}]"
    turn = math.degrees(yaw_rad(time_s - LATE_S))
    return (
        f'<font size="28">FrameCnt: 1\n{place} [rel_alt: 30.000 abs_alt: 530.0] '
        f"[gb_yaw: {turn:.2f} gb_pitch: {PITCH_DEG} gb_roll: 0.0] </font>"
    )


@pytest.fixture(scope="module")
def dji(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dji")
    (folder / "DJI_0042.SRT").write_text(subtitles(dji_lines, SECONDS), "utf-8")
    return write_video(folder / "DJI_0042.MP4", SECONDS)


@pytest.fixture(scope="module")
def fmv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    packets = []
    for n in range(round(SECONDS * RATE_HZ)):
        t = n / RATE_HZ
        values = {5: 90.0, 6: 0.0, 7: 0.0, 13: LATITUDE, 14: LONGITUDE, 15: 700.0, 16: FOV_DEG}
        values |= {18: math.degrees(yaw_rad(t - LATE_S)) % 360, 19: 0.0, 20: 0.0, 25: 500.0}
        packets.append((t, 0.05, klv_packet(10**15 + round(1e6 * t), values)))
    return write_video(tmp_path_factory.mktemp("fmv") / "fmv.ts", SECONDS, "klv", packets)


def test_telemetry_is_read_though_a_packet_seems_to_be_of_a_new_stream(
    fmv: Path, tmp_path: Path
) -> None:
    """One byte of an MPEG-TS is wrong: FFmpeg finds a stream that PyAV does not know."""
    data, pid = bytearray(fmv.read_bytes()), b"\x47\x41\x00"
    starts = [at for at in range(0, len(data), 188) if data[at : at + 3] == pid]
    data[starts[len(starts) * 3 // 4] + 2] = 202
    path = tmp_path / "fmv.ts"
    path.write_bytes(data)
    assert len(read_telemetry(path).attitudes) >= len(read_telemetry(fmv).attitudes) - 2


@pytest.fixture(scope="module")
def gopro(tmp_path_factory: pytest.TempPathFactory) -> Path:
    payloads = [
        (float(n), 1.0, gopro_payload(n, LATE_S, 100 * (n + 1))) for n in range(int(SECONDS))
    ]
    return write_video(
        tmp_path_factory.mktemp("gopro") / "GX010042.MP4", SECONDS, "bin_data", payloads
    )


@pytest.mark.slow
def test_a_dji_video_becomes_a_flight_with_place_height_and_gimbal(
    dji: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    flight = imported(monkeypatch, tmp_path / "runs", dji, "--fov", FOV_DEG)
    assert "Time offset 0.3" in capsys.readouterr().out
    offset = flight.config.run["offset"]
    assert offset["seconds"] == pytest.approx(LATE_S, abs=0.02)
    assert 0 < offset["plus_or_minus_s"] < 0.05
    assert len(flight.frames) == round(SECONDS * RATE_HZ)
    assert all(record.track is None for record in flight.log.tracks)
    vehicle = flight.log.controls[-50].vehicle
    assert vehicle.position.height_m == pytest.approx(30.0)
    assert (vehicle.origin.latitude_deg, vehicle.origin.longitude_deg) == (LATITUDE, LONGITUDE)
    assert vehicle.position.north_m_s == pytest.approx(1.11, abs=0.15)
    camera = vehicle.gimbal.attitude
    assert math.degrees(camera.pitch_rad) == pytest.approx(PITCH_DEG)
    assert camera.yaw_rad == pytest.approx(yaw_rad(camera.time_s), abs=0.02)
    report = flight.folder / "inspection.html"
    assert "Time offset between video and telemetry" in report.read_text("utf-8")
    assert (flight.folder / "offset.png").is_file()
    report.unlink()
    assert run(monkeypatch, "inspect", flight.folder) == 0
    assert report.stat().st_size > 10_000
    assert run(monkeypatch, "replay", flight.folder) == 0


@pytest.mark.slow
def test_misb_klv_turns_the_camera_with_aircraft_and_gimbal(
    fmv: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = imported(monkeypatch, tmp_path / "runs", fmv)
    assert flight.config.run["offset"]["seconds"] == pytest.approx(LATE_S, abs=0.02)
    assert flight.config.run["offset"]["image_turns_per_gyro"] == pytest.approx(1.0, abs=0.1)
    vehicle = flight.log.controls[-50].vehicle
    assert math.degrees(vehicle.attitude.yaw_rad) == pytest.approx(90.0, abs=0.01)
    assert vehicle.position.height_m == pytest.approx(200.0, abs=0.5)
    assert not vehicle.gimbal.from_north
    width, focal = (flight.config.settings["camera"][k] for k in ("focal_width_px", "focal_px"))
    assert 2 * math.degrees(math.atan(width / 2 / focal)) == pytest.approx(FOV_DEG, abs=0.01)


@pytest.mark.slow
def test_gopro_s_gyro_is_compared_with_its_pictures(
    gopro: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = imported(monkeypatch, tmp_path / "runs", gopro, "--fov", FOV_DEG)
    assert flight.config.run["offset"]["seconds"] == pytest.approx(LATE_S, abs=0.02)
    rows = attitudes_of(flight)
    wanted = [yaw_rate_rad_s(time_s) for time_s in rows[:, 0]]
    assert rows[:, 6] == pytest.approx(np.array(wanted), abs=0.01)
    assert flight.log.controls[-50].vehicle.position.north_m_s == pytest.approx(4.0, abs=0.1)


@pytest.mark.slow
def test_a_camera_that_does_not_turn_keeps_the_file_s_own_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    video = write_video(tmp_path / "still.mp4", 5.0, pans=False)
    lines = f"GPS({LONGITUDE},{LATITUDE},14) BAROMETER:12.0"
    video.with_suffix(".srt").write_text(subtitles(lambda _: lines, 5.0, 1.0))
    flight = imported(monkeypatch, tmp_path / "runs", video)
    assert "the telemetry tells no turns" in capsys.readouterr().out
    assert flight.config.run["offset"]["seconds"] == 0.0
    assert flight.log.controls[-1].vehicle.position.height_m == pytest.approx(12.0)
    assert flight.log.controls[-1].vehicle.attitude is None


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bin", "ulg", "srt"])
def test_telemetry_alone_becomes_a_flight_without_pictures(
    kind: str,
    writers: Any,
    script: Any,
    dji: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = dji.with_suffix(".SRT")
    if kind != "srt":
        log = writers[kind](tmp_path / f"log.{kind}", script)
    flight = imported(monkeypatch, tmp_path / "runs", log)
    assert not flight.frames
    assert not (flight.folder / "video.mkv").exists()
    record = flight.log.controls[200]
    if kind != "srt":
        time_s = record.vehicle.position.time_s - 3.0
        place = record.vehicle.position
        assert (place.north_m, place.east_m, place.down_m) == pytest.approx(
            script.position(time_s), abs=0.01
        )
        assert attitudes_of(flight)[100, 1:4] == pytest.approx(
            np.array(script.angles(attitudes_of(flight)[100, 0] - 3.0)), abs=2e-3
        )
    assert (flight.folder / "inspection.html").is_file()


def write_bag(path: Path) -> Path:
    """Write what a camera and MAVROS publish: raw images, Imu, odometry, NavSatFix, State."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="pip install -e .[ros]")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state = "std_msgs/Header header\nbool connected\nbool armed\nbool guided\nstring mode\n"
    store.register(get_types_from_msg(state, "mavros_msgs/msg/State"))
    kinds = store.types

    def header(t: float) -> Any:
        seconds, rest = divmod(round((1000 + t) * 1e9), 10**9)
        return kinds["std_msgs/msg/Header"](
            kinds["builtin_interfaces/msg/Time"](seconds, rest), "map"
        )

    with rosbag2.Writer(path, version=9) as writer:
        topics: dict[str, Any] = {}

        def write(topic: str, kind: str, t: float, *fields: Any) -> None:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            message = kinds[kind](header(t), *fields)
            writer.write(topics[topic], round((1000 + t) * 1e9), store.serialize_cdr(message, kind))

        vector, point = kinds["geometry_msgs/msg/Vector3"], kinds["geometry_msgs/msg/Point"]
        no_9, status = np.zeros(9), kinds["sensor_msgs/msg/NavSatStatus"](0, 1)
        write("/mavros/state", "mavros_msgs/msg/State", 0.0, True, True, True, "OFFBOARD")
        for n, image in enumerate(pictures(SECONDS)):
            t = n / RATE_HZ
            yaw = math.pi / 2 - yaw_rad(t - LATE_S)  # ROS: from east, counter-clockwise
            q = kinds["geometry_msgs/msg/Quaternion"](
                0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)
            )
            turn = vector(0.0, 0.0, -yaw_rate_rad_s(t - LATE_S))
            imu = q, no_9, turn, no_9, vector(0.0, 0.0, 9.81), no_9
            write("/mavros/imu/data", "sensor_msgs/msg/Imu", t, *imu)
            pose = kinds["geometry_msgs/msg/Pose"](point(2.0, 3.0, 4.0), q)
            write("/mavros/local_position/pose", "geometry_msgs/msg/PoseStamped", t, pose)
            fix = status, LATITUDE, LONGITUDE, 500.0, no_9, 0
            write("/mavros/global_position/global", "sensor_msgs/msg/NavSatFix", t, *fix)
            height, width = image.shape[:2]
            data = height, width, "bgr8", 0, 3 * width, np.ravel(image)
            write("/camera/image_raw", "sensor_msgs/msg/Image", t, *data)
    return path


@pytest.mark.slow
def test_a_rosbag2_becomes_a_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write_bag(tmp_path / "bag")
    flight = imported(monkeypatch, tmp_path / "runs", bag, "--fov", FOV_DEG)
    assert flight.config.run["offset"]["seconds"] == pytest.approx(LATE_S, abs=0.02)
    assert len(flight.frames) == round(SECONDS * RATE_HZ)
    vehicle = flight.log.controls[-50].vehicle
    place = vehicle.position
    assert (place.north_m, place.east_m, place.down_m) == pytest.approx((3.0, 2.0, -4.0))
    assert vehicle.mode == "OFFBOARD"
    rows = attitudes_of(flight)
    assert rows[:, 3] == pytest.approx(np.array([yaw_rad(t) for t in rows[:, 0]]), abs=0.02)


def wrong_subtitles(path: Path) -> Path:
    path.write_text("1\n00:00:00,000 --> 00:00:02,000\n- Hello!\n\n")
    return path


def cut(path: Path, source: Path, share: float) -> Path:
    data = source.read_bytes()
    path.write_bytes(data[: round(len(data) * share)])
    return path


def broken_bag(path: Path) -> Path:
    path.mkdir()
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "make", "says"),
    [
        ("film.srt", lambda path, _: wrong_subtitles(path), "no position of a drone"),
        ("cut.SRT", lambda path, s: cut(path, s[0].with_suffix(".SRT"), 0.001), "no position"),
        ("cut.ts", lambda path, s: cut(path, s[1], 0.0004), "not a video that FFmpeg can open"),
        ("cut.MP4", lambda path, s: cut(path, s[2], 0.9), "is complete"),
        ("missing.mp4", lambda path, _: path, "missing.mp4"),
        ("plain.mp4", lambda path, _: write_video(path, 0.5), "which target?"),
        ("bag", lambda path, _: broken_bag(path), "cannot be read as a bag"),
        ("log.ulg", lambda path, _: cut(path, Path(__file__), 0.5), "no PX4 log"),
        ("log.BIN", lambda path, _: cut(path, Path(__file__), 0.5), "no ArduPilot log"),
    ],
)
def test_what_is_cut_off_or_wrong_ends_in_one_line_and_leaves_nothing(
    name: str,
    make: Callable[[Path, tuple[Path, ...]], Path],
    says: str,
    dji: Path,
    fmv: Path,
    gopro: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = make(tmp_path / name, (dji, fmv, gopro))
    assert run(monkeypatch, "import", path, "-o", tmp_path / "runs") == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.startswith("follower: ")
    assert said.count("\n") == 1
    assert not list((tmp_path / "runs").glob("*"))


def test_two_videos_or_two_logs_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "import", "a.mp4", "b.mp4", "-o", tmp_path) == 2
    assert "a.mp4 and b.mp4 are two videos" in capsys.readouterr().err
