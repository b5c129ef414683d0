"""`follower import`: a rendered flight with a known offset becomes a flight that replays."""

from __future__ import annotations

import io
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from csv_rows import rows_of
from program import output_of
from rich.console import Console
from typer.testing import CliRunner

from follower.apps.import_flight.alignment import align, corner_flows
from follower.apps.import_flight.session import import_video
from follower.apps.main import INTERRUPTED, SUCCESS, app
from follower.apps.replay.comparison import compare
from follower.apps.replay.replay import Replay, replay_settings
from follower.apps.target_choice import TargetChoice
from follower.apps.video_input import UntilResized, VideoInput
from follower.recording import RecordedFlight, open_flight
from follower.recording.telemetry_logs import read_telemetry
from follower.settings.settings import load_settings
from follower_control.common.strict_config import SettingsError
from follower_sim.camera import SimCamera
from follower_sim.scenario.scenario import Scenario
from follower_sim.world.world import World
from follower_vision.drawing.video_writer import VideoWriter
from follower_vision.geometry.box import Box
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.video_file import VideoFile

TRUE_OFFSET_S, FRAME_S, SECONDS = 3.0, 1 / 20, 9.0
MOUNT = CameraMount(pitch_rad=math.radians(-25))
SETTINGS = ("camera.pitch_deg=-25", "servo.target_size_m=2.2", "recorder.keep_free_mb=1")
LOSSLESS = "recorder.video=lossless"
COLOUR = "#e0401c"


@pytest.fixture(scope="session")
def world() -> World:
    data: dict[str, Any] = {
        "name": "import",
        "title": "A car stands in a meadow with rocks.",
        "duration_s": 20,
        "seed": 5,
        "targets": [{"kind": "car", "colour": COLOUR, "path": {"points": [[14, 0], [30, 0]]}}],
        "scatter": [{"kind": "rock", "count": 12, "clear_m": 3, "within_m": 20}],
        "camera": {"width": 320, "height": 240, "rate_hz": 20, "pitch_deg": -25, "jitter_s": 0},
        "start": {"at": [0, 0]},
        "select": {"colour": COLOUR},
    }
    return World(Scenario.model_validate(data))


@pytest.fixture(scope="session")
def render(world: World, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Any, str], Path]:
    folder = tmp_path_factory.mktemp("videos")

    def video(script: Any, name: str) -> Path:
        path = folder / f"{name}.mp4"
        if not path.exists():
            camera = SimCamera(world, script.body)
            with VideoWriter(path, 1 / FRAME_S) as writer:
                for _ in range(round(SECONDS / FRAME_S)):
                    delivery = camera.capture()
                    writer.write(delivery.frame.image, delivery.frame.captured_s)
        return path

    return video


@pytest.fixture(scope="session")
def turning_video(render: Callable[[Any, str], Path], script: Any) -> Path:
    return render(script, "turning")


def imported(
    folder: Path, video: Path, telemetry: Path | None, **more: Any
) -> tuple[RecordedFlight, str]:
    printed = io.StringIO()
    overrides = ("camera.fov_deg=75", *SETTINGS, *more.pop("overrides", ()))
    code = import_video(
        VideoInput(str(video)),
        load_settings(overrides=overrides),
        TargetChoice(colour=COLOUR),
        telemetry=telemetry,
        out=folder,
        console=Console(file=printed, width=200),
        **{"at_s": 0.0, "offset_s": None, **more},
    )
    assert code == 0
    (flight,) = (path for path in folder.iterdir() if path.is_dir())
    return open_flight(flight), printed.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", "tlog", "bin", "ulg"])
def test_the_offset_of_a_turning_flight_is_found_to_less_than_a_frame(
    kind: str, turning_video: Path, writers: Any, script: Any, world: World, tmp_path: Path
) -> None:
    telemetry = read_telemetry(writers[kind](tmp_path / f"log.{kind}", script))
    with VideoFile(turning_video) as source:
        flows = list(corner_flows(iter(source.read, None), world.scenario.camera.model))
    found = align(flows, telemetry, MOUNT)
    assert found.problems == []
    assert abs(found.offset_s - TRUE_OFFSET_S) < 0.5 * FRAME_S
    assert found.unsure_s < FRAME_S
    assert found.scale == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_hover_is_refused_with_a_plot_and_may_be_set_by_hand(
    render: Callable[[Any, str], Path], writers: Any, hover: Any, tmp_path: Path
) -> None:
    video = render(hover, "hover")
    log = writers["csv"](tmp_path / "hover.csv", hover)
    out = tmp_path / "runs"
    with pytest.raises(SourceError, match=r"hardly turns.*--offset"):
        imported(out, video, log)
    assert [path.name for path in out.iterdir()] == ["import-hover-offset.png"]
    flight, _ = imported(tmp_path / "again", video, log, offset_s=TRUE_OFFSET_S)
    assert flight.config.run["offset"] == {"seconds": TRUE_OFFSET_S, "given": "by hand"}


@pytest.fixture(scope="module")
def whole(
    turning_video: Path, writers: Any, script: Any, tmp_path_factory: pytest.TempPathFactory
) -> tuple[RecordedFlight, str]:
    folder = tmp_path_factory.mktemp("imported")
    log = writers["csv"](folder / "log.csv", script)
    return imported(folder / "runs", turning_video, log, overrides=(LOSSLESS,), at_s=1.0)


@pytest.mark.slow
def test_an_imported_flight_has_setpoints_made_with_the_telemetry(
    whole: tuple[RecordedFlight, str], script: Any
) -> None:
    flight, printed = whole
    assert "Time offset 3.0" in printed
    assert len(flight.frames) == round(SECONDS / FRAME_S)
    assert flight.log.tracks[0].track is None
    assert flight.selections[0].captured_s == pytest.approx(1.0, abs=FRAME_S)
    late = [record for record in flight.log.controls if record.time_s > 3]
    assert all(record.sent and record.estimate is not None for record in late)
    for record in late[::40]:
        attitude = record.vehicle.attitude
        assert attitude.yaw_rad == pytest.approx(script.angles(attitude.time_s)[2], abs=0.02)


@pytest.mark.slow
def test_the_target_s_direction_does_not_turn_with_the_vehicle(
    whole: tuple[RecordedFlight, str], script: Any
) -> None:
    flight, _ = whole
    for record in flight.log.controls[200::50]:
        north, east, down = script.position(record.time_s)
        true = math.atan2(0 - east, 14 - north)
        assert record.estimate.azimuth_rad == pytest.approx(true, abs=math.radians(4))
        assert down < 0


@pytest.mark.slow
def test_an_imported_flight_replays_bit_for_bit(whole: tuple[RecordedFlight, str]) -> None:
    flight, _ = whole
    replayed = Replay(flight, replay_settings(flight)).run()
    assert compare(flight.log, replayed).identical


@pytest.mark.slow
def test_the_delay_of_a_recorded_flight_s_camera_is_found(
    whole: tuple[RecordedFlight, str], tmp_path: Path
) -> None:
    flight, _ = whole
    out = tmp_path / "latency.yaml"
    output_of("calibrate", "latency", str(flight.folder), "--out", str(out))
    assert abs(load_settings(out).camera.latency_s) < 0.5 * FRAME_S


@pytest.mark.slow
def test_its_report_shows_the_offset(whole: tuple[RecordedFlight, str]) -> None:
    flight, _ = whole
    page = (flight.folder / "inspection.html").read_text("utf-8")
    assert "Time offset between video and telemetry" in page
    assert (flight.folder / "offset.png").stat().st_size > 10_000
    for name in ("boxes.csv", "setpoints.csv", "config.yaml"):
        assert (flight.folder / name).is_file()


@pytest.mark.slow
def test_a_video_alone_gives_setpoints_on_the_body_s_axes(
    turning_video: Path, tmp_path: Path
) -> None:
    flight, _ = imported(tmp_path, turning_video, None)
    assert not flight.config.needs_telemetry
    assert flight.config.settings["envelope"]["min_height_m"] is None
    assert any(record.sent for record in flight.log.controls)
    assert all(record.vehicle.attitude is None for record in flight.log.controls)


@pytest.mark.slow
def test_telemetry_of_another_time_is_refused(
    turning_video: Path, writers: Any, script: Any, tmp_path: Path
) -> None:
    log = writers["csv"](tmp_path / "log.csv", script)
    with pytest.raises(SourceError, match="nothing of it belongs to the video"):
        imported(tmp_path / "runs", turning_video, log, offset_s=500.0)
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_a_target_that_never_shows_leaves_nothing_behind(
    turning_video: Path, tmp_path: Path
) -> None:
    with pytest.raises(SourceError, match=r"was not seen .* the recording ends at \d+\.\d s"):
        imported(tmp_path / "runs", turning_video, None, at_s=100.0)
    assert not (tmp_path / "runs").exists()


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Ten of one size, of which the fourth is damaged, and two of another."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    ground = np.random.default_rng(1).integers(0, 255, (60, 90, 3), np.uint8)
    for number in range(12):
        image = ground[:48, : 64 if number < 10 else 80]
        cv2.imwrite(str(folder / f"{number}.png"), image)
    (folder / "3.png").write_bytes(b"no picture")
    return folder


def followed(pictures: Path, at_s: float) -> tuple[int, str]:
    printed = io.StringIO()
    code = import_video(
        VideoInput(str(pictures), rate_hz=10),
        load_settings(overrides=("recorder.keep_free_mb=1",)),
        TargetChoice(boxes=(Box.from_xywh(20, 15, 20, 16),)),
        at_s,
        None,
        None,
        pictures.parent / "runs",
        Console(file=printed, width=200),
    )
    return code, printed.getvalue()


def test_what_ended_the_video_early_is_told(pictures: Path) -> None:
    code, printed = followed(pictures, 0.0)
    assert code == SUCCESS
    assert "frame 10 is 80x48 pixels, the ones before were not: the run ends there" in printed
    flight = open_flight(pictures.parent / "runs" / "import-pictures")
    assert [event.text for event in flight.log.events if event.source == "video"] == [
        "frame 10 is 80x48 pixels, the ones before were not: the run ends there"
    ]
    (pictures / "10.png").unlink()
    (pictures / "11.png").unlink()
    _, printed = followed(pictures, 0.0)
    assert "3.png: not a readable picture" in printed


@pytest.mark.parametrize(("at_s", "kept"), [(0.0, 6), (100.0, 0)])
def test_ctrl_c_keeps_what_there_is(
    pictures: Path, monkeypatch: pytest.MonkeyPatch, at_s: float, kept: int
) -> None:
    read = UntilResized.read

    def pressing(frames: UntilResized) -> Frame | None:
        frame = read(frames)
        if frame is not None and frame.sequence == 6:
            signal.raise_signal(signal.SIGINT)
        return frame

    monkeypatch.setattr(UntilResized, "read", pressing)
    code, printed = followed(pictures, at_s)
    assert code == INTERRUPTED
    folder = pictures.parent / "runs" / "import-pictures"
    if kept:
        assert len(open_flight(folder).log.tracks) == len(rows_of(folder / "boxes.csv")) == kept
        assert (folder / "inspection.html").is_file()
    else:
        assert "Ended while waiting for the target: nothing is written" in printed
        assert not folder.parent.exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("clip.mp4", "--colour", COLOUR, "--offset", "1"), "--offset needs --telemetry"),
        (("clip.mp4", "--colour", COLOUR, "--at", "-1"), "--at"),
        (("clip.mp4", "--colour", COLOUR, "--target", "5,5,4,4"), "alone"),
        (("clip.mp4", "--select", "list"), "follower track"),
        (("rtsp://10.0.0.5/live", "--colour", COLOUR), "recording"),
    ],
)
def test_contradictions_are_refused(options: tuple[str, ...], says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        CliRunner().invoke(app, ["import", *options], catch_exceptions=False)


@pytest.mark.parametrize("name", ["nowhere.mp4", "~nobody-of-this-name/clip.mp4"])
def test_the_command_names_a_missing_file(name: str) -> None:
    result = CliRunner().invoke(app, ["import", name, "--target", "1,2,30,40"])
    assert isinstance(result.exception, SourceError)
    assert name in str(result.exception)
