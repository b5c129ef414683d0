"""`follower track` from end to end: several targets, files as promised, nothing half-written."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from csv_rows import rows_of
from real_data import DATA, needs_data

import follower.apps.track.session as track_module
from follower.apps.main import FAILED, SUCCESS, UNUSABLE, main
from follower.apps.track.display import TrackStatus, status_line
from follower.apps.track.run import TrackFiles
from follower.recording.run_folder import BOX_COLUMNS
from follower.settings.settings import Settings
from follower_vision.detection import Detection
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.sources.open import open_source
from follower_vision.trackers.track import Track, TrackState

FRAMES, SIDE = 30, 28
COLOURS = ((30, 30, 220), (40, 200, 40), (220, 60, 40))

Run = Callable[..., tuple[int, str, str]]


STARTS = ((150, 90), (40, 150), (250, 20))
STEPS = ((1, 1), (3, 0), (-1, 2))


def corner(target: int, frame: int) -> tuple[int, int]:
    """Where a square's top-left corner is; the first begins nearest to the centre."""
    (x, y), (right, down) = STARTS[target], STEPS[target]
    return x + right * frame, y + down * frame


class SquareDetector:
    """Knows the red and the green squares as persons and the blue one as a car."""

    class_names = ("person", "car")

    def __init__(self) -> None:
        self.passes = 0

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        self.passes += 1
        found = []
        for colour, class_id in zip(COLOURS, (0, 0, 1), strict=True):
            like = (np.abs(image.astype(int) - colour).sum(axis=2) < 60).astype(np.uint8)
            if like.sum() > 100:
                box = Box.from_xywh(*map(float, cv2.boundingRect(like)))
                if region is None or region.intersection(box) > 0.9 * box.area:
                    found.append(Detection(box, class_id, self.class_names[class_id], 0.9))
        return found


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three squares over a grey texture; the blue one is there from the fifth picture only."""
    folder = tmp_path_factory.mktemp("squares")
    rng = np.random.default_rng(5)
    coarse = rng.integers(60, 180, (24, 32), dtype=np.uint8)
    grey = cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_LINEAR)
    ground = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    for number in range(FRAMES):
        image = ground.copy()
        for target, colour in enumerate(COLOURS):
            if target < 2 or number >= 5:
                x, y = corner(target, number)
                cv2.rectangle(image, (x, y), (x + SIDE - 1, y + SIDE - 1), colour, -1)
                cv2.rectangle(image, (x + 8, y + 8), (x + 16 + target, y + 12), (220, 220, 220), -1)
        cv2.imwrite(str(folder / f"{number:03d}.png"), image)
    return folder


@pytest.fixture
def detector(monkeypatch: pytest.MonkeyPatch) -> SquareDetector:
    """Stands where the settings' network would."""
    squares = SquareDetector()

    def make(settings: Settings) -> SquareDetector | None:
        return None if settings.detector is None else squares

    monkeypatch.setattr(track_module, "make_settings_detector", make)
    return squares


@pytest.fixture
def run_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Run:
    """Run the program here; return its exit code and what it printed."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["follower", "track", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capfd.readouterr()
        return int(ended.value.code or 0), printed.out, printed.err

    return run


@pytest.fixture
def run(run_program: Run, detector: SquareDetector) -> Run:  # noqa: ARG001
    """Run the program with the detector of squares."""
    return run_program


def only_run(folder: Path) -> Path:
    (found,) = (folder / "runs").iterdir()
    return found


def assert_on_target(rows: Sequence[dict[str, str]], target: int) -> None:
    for row in rows:
        x, y = corner(target, int(row["frame"]))
        assert float(row["x"]) == pytest.approx(x, abs=5)
        assert float(row["y"]) == pytest.approx(y, abs=5)


def test_one_target_has_one_line_a_frame_with_the_columns_promised(
    run: Run, pictures: Path, tmp_path: Path
) -> None:
    code, out, _ = run(str(pictures), "--select", "person", "--boxes", "out.csv", "--no-video")
    assert code == SUCCESS, out
    rows = rows_of(tmp_path / "out.csv")
    assert tuple(rows[0]) == BOX_COLUMNS
    assert [int(row["frame"]) for row in rows] == list(range(FRAMES))
    assert float(rows[3]["time"]) == pytest.approx(0.1)
    assert_on_target(rows, 0)
    assert "following person:1 of 2 person in frame 0" in out
    files = {path.name for path in only_run(tmp_path).iterdir()}
    assert files == {"candidates.png", "track.png", "setpoints.csv"}


@pytest.mark.slow
@pytest.mark.parametrize("choice", ["boxes", "classes"])
def test_several_targets_are_numbered_in_the_order_given(
    run: Run, pictures: Path, detector: SquareDetector, tmp_path: Path, choice: str
) -> None:
    arguments = ("--select", "person:2", "--select", "person:1")
    if choice == "boxes":
        boxes = ("--target", "40,150,28,28", "--target", "150,90,28,28")
        arguments = (*boxes, "--tracker", "correlation")
    code, out, _ = run(str(pictures), *arguments, "--save", "out.mp4")
    assert code == SUCCESS, out
    rows = rows_of(only_run(tmp_path) / "boxes.csv")
    assert tuple(rows[0]) == (*BOX_COLUMNS, "target")
    assert [row["target"] for row in rows] == ["1", "2"] * FRAMES
    assert_on_target(rows[0::2], 1)
    assert_on_target(rows[1::2], 0)
    assert cv2.imread(str(only_run(tmp_path) / "track.png")) is not None
    with open_source(str(tmp_path / "out.mp4")) as video:
        assert sum(1 for _ in iter(video.read, None)) == FRAMES
    assert (detector.passes > 0) == (choice == "classes")


@pytest.mark.slow
def test_a_recording_gives_the_same_boxes_each_time(
    run: Run, pictures: Path, tmp_path: Path
) -> None:
    for name in ("a.csv", "b.csv"):
        choice = ("--select", "person:1", "--select", "person:2")
        run(str(pictures), *choice, "--no-video", "--boxes", name)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_a_class_is_waited_for_and_the_video_begins_with_the_target(
    run: Run, pictures: Path, tmp_path: Path
) -> None:
    code, out, _ = run(str(pictures), "--select", "car")
    assert code == SUCCESS, out
    assert "following car:1 of 2 person, 1 car in frame 5" in out
    folder = only_run(tmp_path)
    rows = rows_of(folder / "boxes.csv")
    assert [row["state"] for row in rows[:6]] == ["none"] * 5 + ["tracking"]
    assert_on_target(rows[5:], 2)
    with open_source(str(folder / "track.mp4")) as video:
        assert sum(1 for _ in iter(video.read, None)) == FRAMES - 5


def test_the_list_shows_what_may_be_chosen_and_follows_nothing(
    run: Run, pictures: Path, tmp_path: Path
) -> None:
    code, out, _ = run(str(pictures), "--select", "list")
    assert code == SUCCESS
    assert re.search(r"1 .* person:1 .* 0.90 .* 150,90,28,28", out)
    assert re.search(r"2 .* person:2 .* 0.90 .* 40,150,28,28", out)
    assert [path.name for path in only_run(tmp_path).iterdir()] == ["candidates.png"]
    assert cv2.imread(str(only_run(tmp_path) / "candidates.png")).shape == (960, 1280, 3)


@pytest.mark.slow
def test_in_real_time_a_recording_takes_its_time(run: Run, pictures: Path, tmp_path: Path) -> None:
    code, out, _ = run(str(pictures), "--select", "person", "--realtime", "--no-video")
    assert code == SUCCESS, out
    assert re.search(r"\d+ dropped", out)
    rows = rows_of(only_run(tmp_path) / "boxes.csv")
    times = [float(row["time"]) - int(row["frame"]) / 30 for row in rows]
    assert max(times) - min(times) < 1e-3
    assert not (only_run(tmp_path) / "setpoints.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize("pace", [[], ["--realtime"]])
def test_a_damaged_recording_is_followed_as_far_as_it_goes_and_the_exit_code_tells(
    run: Run, pictures: Path, tmp_path: Path, pace: list[str]
) -> None:
    damaged = tmp_path / "damaged"
    shutil.copytree(pictures, damaged)
    (damaged / "012.png").write_bytes(b"no picture")
    x, y = corner(0, 0)
    code, out, _ = run(str(damaged), "--target", f"{x},{y},{SIDE},{SIDE}", "--no-video", *pace)
    assert code == FAILED
    assert "012.png" in out
    rows = rows_of(only_run(tmp_path) / "boxes.csv")
    assert int(rows[-1]["frame"]) == FRAMES - 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--target", "1,2,1,1"], "fewer than 3 pixels"),
        (["--target", "40,150,28,28", "--target", "900,2,30,30"], "lies outside the image"),
        (["--target", "310,100,30,30"], "with 33% of it only in the image, which is 320x240"),
        (["--select", "persn"], "did you mean 'person'"),
        (["--select", "person", "--target", "1,2,30,30"], "one of --target, --select and --colour"),
        (["--colour", "#c020c0"], "colour #c020c0 was not seen in 30 frames"),
        (["--select", "1", "--set", "appearance=osnet-x0.25"], "appearance is gone"),
        (["--select", "1", "--save", "missing/out.mp4"], "there is no folder missing"),
        (["--select", "1", "--save", "out.avi"], "ends in .mp4"),
        (["--select", "1", "--save", "/proc/out.mp4"], "cannot be written|there is no folder"),
        (["--select", "1", "--save", "{source}/out.mp4", "--boxes", "{source}/out.mp4"], "both"),
        (["--select", "1", "--boxes", "{source}"], "this is a folder"),
        (["--select", "1", "--boxes", "{source}/../{name}"], "this is a folder"),
        (["--select", "1", "--rate-hz", "0"], "needs a positive rate"),
        (["--select", "1", "--set", "camera.frame_size=[64,48]"], "frame_size says 64x48: give"),
        (["--select", "1", "--tracker", "goturn"], "no such tracker"),
        (["--target", "9,9,4,4", "--tracker", "mil"], "cannot be followed: .* a larger box"),
    ],
)
def test_bad_input_ends_in_one_line_and_writes_nothing(
    run: Run,
    pictures: Path,
    tmp_path: Path,
    arguments: list[str],
    message: str,
) -> None:
    filled = [text.format(source=pictures, name=pictures.name) for text in arguments]
    code, _, err = run(str(pictures), *filled)
    assert code == UNUSABLE
    assert err.count("\n") == 1
    assert re.search(message, err)
    assert list(tmp_path.iterdir()) == []
    assert len(list(pictures.iterdir())) == FRAMES


def test_a_box_that_reaches_beyond_the_image_is_cut_off_there_and_told(
    run: Run, pictures: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run(str(pictures), "--target", "300,100,30,30", "--no-video")
    assert [record.getMessage() for record in caplog.records] == [
        "the target 300,100,30,30 reaches beyond the image, which is 320x240: "
        "300,100,20,30 is followed"
    ]
    first = rows_of(only_run(tmp_path) / "boxes.csv")[0]
    assert [float(first[name]) for name in "xywh"] == [300, 100, 20, 30]


@pytest.mark.parametrize("wish", ["person:3", "7"])
def test_a_number_too_large_leaves_the_picture_to_choose_from_alone(
    run: Run, pictures: Path, tmp_path: Path, wish: str
) -> None:
    code, _, err = run(str(pictures), "--select", wish)
    assert code == UNUSABLE
    assert err.count("\n") == 1
    picture = only_run(tmp_path) / "candidates.png"
    assert f"{picture.relative_to(tmp_path)} shows what may be chosen" in err
    assert list(only_run(tmp_path).iterdir()) == [picture]


@pytest.mark.slow
def test_the_source_is_never_overwritten(
    run: Run, pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(str(pictures), "--select", "1", "--save", "clip.mp4")
    before = (tmp_path / "clip.mp4").read_bytes()
    (tmp_path / "second-name.mp4").hardlink_to(tmp_path / "clip.mp4")
    monkeypatch.setenv("HOME", str(tmp_path))
    for source, option, name in (
        ("clip.mp4", "--save", "./clip.mp4"),
        ("clip.mp4", "--boxes", "./clip.mp4"),
        ("clip.mp4", "--save", "second-name.mp4"),
        ("~/clip.mp4", "--save", str(tmp_path / "clip.mp4")),
    ):
        code, _, err = run(source, "--target", "40,150,28,28", option, name)
        assert code == UNUSABLE
        assert "that is the source itself" in err
    assert (tmp_path / "clip.mp4").read_bytes() == before


def test_looking_whether_a_file_can_be_written_leaves_everything_as_it_was(tmp_path: Path) -> None:
    link, kept, pipe = (tmp_path / name for name in ("link.csv", "kept.csv", "pipe"))
    link.symlink_to(tmp_path / "not-yet.csv")
    kept.write_text("old")
    os.mkfifo(pipe)  # opened, it would wait for a reader
    for boxes in (link, kept, pipe, tmp_path / "new.csv"):
        TrackFiles(boxes=boxes).check(tmp_path / "clip.mp4")
    assert sorted(tmp_path.iterdir()) == [kept, link, pipe]
    assert link.is_symlink()
    assert kept.read_text() == "old"


def test_a_missing_network_names_what_fetches_it(
    run_program: Run, pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FOLLOWER_MODELS", str(tmp_path / "none"))
    code, _, err = run_program(str(pictures), "--select", "person")
    assert code == UNUSABLE
    assert "`follower models pull yolox-nano` fetches it" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_change_of_size_ends_the_run_in_order(run: Run, pictures: Path, tmp_path: Path) -> None:
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    for number in range(10):
        image = cv2.imread(str(pictures / f"{number:03d}.png"))
        height = 240 if number < 6 else 200
        cv2.imwrite(str(mixed / f"{number}.png"), image[:height])
    code, out, _ = run(str(mixed), "--select", "1")
    assert code == 1  # the recording breaks off
    assert "frame 6 is 320x200 pixels" in out
    assert len(rows_of(only_run(tmp_path) / "boxes.csv")) == 6


def test_the_line_tells_state_rate_delay_drops_and_reconnects() -> None:
    track = Track(Box(5, 5, 5, 5), TrackState.TRACKING, 0.93, "correlation", 1.0, 3)
    status = TrackStatus(tracks=(track,), delay_s=0.041, skipped=3, reconnects=1)
    line = status_line(status, "person", 29.8)
    assert line == "tracking 0.93  30 frames/s  delay 41 ms  3 dropped  1 reconnect"
    waiting = status_line(TrackStatus(), "person", None)
    assert waiting == "waiting for person"
    broken = status_line(TrackStatus(tracks=(track,), problem="rtsp://a: no stream"), "person", 0.0)
    assert broken == "no frames: rtsp://a: no stream"


@needs_data("sequences/otb_jogging1", "weights/yolox_nano_bi.onnx")
@pytest.mark.slow
def test_a_person_in_real_footage_is_chosen_by_its_number_and_followed(
    run_program: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence, weights = DATA / "sequences" / "otb_jogging1", DATA / "weights"
    monkeypatch.setenv("FOLLOWER_MODELS", str(weights))
    arguments = ("--select", "person:1", "--select", "person:2", "--no-video")
    code, out, _ = run_program(str(sequence), *arguments)
    assert code == SUCCESS, out
    rows = rows_of(only_run(tmp_path) / "boxes.csv")
    truth = np.loadtxt(sequence / "groundtruth.txt", delimiter=",")
    first = Box.from_xywh(*truth[0])
    overlaps = [first.iou(box_of(row)) for row in rows[:2]]
    target = int(np.argmax(overlaps))
    assert overlaps[target] > 0.5
    follows = [
        Box.from_xywh(*true).iou(box_of(row)) > 0.5
        for true, row in zip(truth[:60], rows[target::2], strict=False)
    ]
    assert np.mean(follows) > 0.8


def box_of(row: dict[str, str]) -> Box:
    return Box.from_xywh(*(float(row[name]) for name in "xywh"))
