"""`follower calibrate`: from a folder of images to settings that fly and track take."""

import io
import os
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console, Group
from typer.testing import CliRunner

from follower.calibration import display, session
from follower.calibration.board import Board
from follower.calibration.views import ViewCollection
from follower.cli import app
from follower.settings import CameraSettings, load_settings
from follower_control.strict_yaml import SettingsError
from follower_vision.camera import CameraModel
from follower_vision.frame import Image

Pose = tuple[float, float, float, float, float, float]
Render = Callable[[Board, CameraModel, Pose], Image]
BIG = 72 / 0.0254


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["calibrate", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, " ".join(result.output.split())


def image_of(path: Path) -> Image:
    image = cv2.imread(str(path))
    assert image is not None
    return np.asarray(image, np.uint8)


@pytest.fixture(scope="module")
def photos(
    tmp_path_factory: pytest.TempPathFactory, lens: CameraModel, render: Render, poses: list[Pose]
) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for number, pose in enumerate(poses):
        cv2.imwrite(str(folder / f"{number:02}.png"), render(Board(), lens, pose))
    return folder


def test_images_become_settings_and_a_picture(
    photos: Path, tmp_path: Path, lens: CameraModel
) -> None:
    known = tmp_path / "mine.yaml"
    known.write_text("camera: {pitch_deg: -30, fov_deg: 50}\nservo: {distance_m: 9}\n")
    out = tmp_path / "lens" / "wide.yaml"
    code, said = run(photos, "--out", out, "-c", known)
    assert code == 0
    assert "focal length 45" in said
    assert "px off over" in said
    assert "mount" not in out.read_text()
    settings = load_settings(out)
    assert (settings.camera.pitch_deg, settings.servo.distance_m) == (-30, 9)
    assert settings.camera.frame_size == (640, 480)
    found = settings.camera.model(640, 480)
    assert found.fx == pytest.approx(lens.fx, rel=0.01)
    assert (found.cx, found.cy) == pytest.approx((lens.cx, lens.cy), abs=2.5)
    half = settings.camera.model(320, 240)
    assert (half.fx, half.cx, half.cy) == pytest.approx((found.fx / 2, found.cx / 2, found.cy / 2))
    shown = image_of(out.with_suffix(".png"))
    assert shown.shape == (514, 1280, 3)
    assert np.ptp(shown[40:, :640]) > 100, "coverage"
    assert np.ptp(shown[40:, 640:]) > 100, "an undistorted image"
    if wanted := os.environ.get("FOLLOWER_PICTURES"):  # `docs/pictures`, for the guides
        coarse = (shown // 16 * 16 + 8).astype(np.uint8)  # without noise it is a sixth as large
        cv2.imwrite(str(Path(wanted) / "calibration.png"), coarse)


def test_a_camera_is_watched_until_there_are_views_enough(
    photos: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    keep_terminal: Callable[[Console, str, str], None],
) -> None:
    console = Console(record=True, width=100, file=io.StringIO())
    seen: list[Group] = []

    def shown(views: ViewCollection, board_in_sight: bool) -> Group:
        seen.append(display.shown(views, board_in_sight))
        return seen[-1]

    monkeypatch.setattr(session, "shown", shown)
    monkeypatch.setattr(session, "is_live", lambda _: True)
    monkeypatch.setattr(display, "GOOD_VIEWS", 10)
    monkeypatch.setattr(display, "GOOD_COVERAGE", 0.6)
    code, said = run(photos, "--out", tmp_path / "camera.yaml", "--every-s", 0)
    assert code == 0
    looked = re.search(r"(\d+) images: (\d+) views kept", said)
    assert looked is not None
    assert 10 <= int(looked[2]) <= int(looked[1]) < len(list(photos.iterdir())), "it ended early"
    assert "Ctrl-C ends it and computes the lens" in said
    console.print(seen[len(seen) // 2])
    assert "the board is in sight; next: show it at the" in console.export_text(clear=False)
    keep_terminal(console, "follower calibrate 0", "calibrating")


def test_what_is_there_is_not_overwritten(photos: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.png").write_text("mine")
    with pytest.raises(SettingsError, match=r"camera\.png exists already"):
        run(photos, "--out", tmp_path / "camera.yaml")


def test_images_without_the_board_say_so(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), np.full((120, 160, 3), 90, np.uint8))
    code, said = run(tmp_path, "--out", tmp_path / "camera.yaml")
    assert code == 1
    assert "the board was never seen" in said
    assert not (tmp_path / "camera.yaml").exists()


def test_too_few_views_say_how_many_are_needed(photos: Path, tmp_path: Path) -> None:
    for name in ("00.png", "05.png", "10.png"):
        (tmp_path / name).write_bytes((photos / name).read_bytes())
    code, said = run(tmp_path, "--out", tmp_path / "camera.yaml")
    assert code == 1
    assert "3 different views of the board are too few: 8 are needed" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "which source"),
        (("clip.mp4", "--board", "board.pdf"), "give no source"),
        (("clip.mp4", "--kind", "circles"), "charuco or chessboard"),
        (("clip.mp4", "--squares", "7*10"), "write it like 7x10"),
        (("--kind", "chessboard", "--squares", "8x10", "--board", "b.pdf"), "which way up"),
        (("--board", "board.svg"), "pdf or .png"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    arguments: tuple[str, ...], words: str
) -> None:
    with pytest.raises(SettingsError, match=re.escape(words)):
        run(*arguments)


@pytest.mark.parametrize("kind", ["charuco", "chessboard"])
def test_a_board_is_printed_to_scale(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "board.pdf"
    code, said = run("--board", path, "--kind", kind)
    assert code == 0
    assert "175 x 250 mm, squares of 25 mm, on A4" in said
    pdf = path.read_bytes()
    rectangles = [
        tuple(map(float, match.groups()))
        for match in re.finditer(rb"([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re f", pdf)
    ]
    left, bottom, width, height = np.array(rectangles).T
    assert (left + width).max() - left.min() == pytest.approx(0.175 * BIG, abs=0.01)
    assert (bottom + height).max() - bottom.min() == pytest.approx(0.250 * BIG, abs=0.01)
    drawn = np.full((842, 596, 3), 255, np.uint8)
    for x, y, w, h in rectangles:
        cv2.rectangle(
            drawn,
            (round(x), round(842 - y - h)),
            (round(x + w) - 1, round(842 - y) - 1),
            (0, 0, 0),
            -1,
        )
    found = Board(kind).find(drawn)  # type: ignore[arg-type]
    assert found is not None
    assert len(found.ids) == 54
    places = [int(one) for one in re.findall(rb"(\d{10}) 00000 n", pdf)]
    assert [pdf[at : at + 7] for at in places] == [b"%d 0 obj" % n for n in range(1, 5)]


def test_a_board_as_png_knows_its_resolution(tmp_path: Path) -> None:
    path = tmp_path / "board.png"
    assert run("--board", path, "--square-mm", 18)[0] == 0
    png = path.read_bytes()
    at = png.index(b"pHYs")
    across, down, unit = struct.unpack(">IIB", png[at + 4 : at + 13])
    assert struct.unpack(">I", png[at + 13 : at + 17])[0] == zlib.crc32(png[at : at + 13])
    assert (unit, across) == (1, down)
    image = image_of(path)
    found = Board(square_m=0.018).find(image)
    assert found is not None
    sides_px = np.diff(found.image_px.reshape(9, 6, 2), axis=1)
    assert np.hypot(*sides_px.reshape(-1, 2).T) / across == pytest.approx(0.018, rel=0.01)


def test_an_axis_outside_of_the_image_is_refused() -> None:
    with pytest.raises(ValueError, match="center_px lies in an image 640 px wide"):
        CameraSettings(center_px=(700.0, 200.0))
    assert CameraSettings(center_px=(300.0, 250.0)).model(640, 480).cx == 300.0
